"""Local polynomials: conversion of a window's samples to values and derivatives at Gauss nodes.

A least-squares polynomial of degree m-1, evaluated at the m Gauss-Legendre nodes of its window,
gives m uncorrelated values that hold all of its information (the discrete analogue of Gauss
quadrature). Its truncation error of order m vanishes at just those nodes. So a window becomes m
independent samples, and nothing is counted twice.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from fsw.messages import FloatArray

CACHED = 16  # patterns of instants whose operators are kept
EXTRA_DEGREE = 3  # of a position's polynomial over a torque's: its second derivative is used
RANK = 1e-9  # of the largest eigenvalue; smaller eigenvalues are rounding


@lru_cache(maxsize=16)
def gauss_nodes(count: int) -> FloatArray:
    """Return the `count` Gauss-Legendre nodes in (-1, 1), ascending."""
    nodes: FloatArray = legendre.leggauss(count)[0]
    nodes.setflags(write=False)
    return nodes


@lru_cache(maxsize=16)
def differentiation(nodes: int) -> FloatArray:
    """Return (m, m): derivatives at the Gauss nodes on [-1, 1] of the interpolant of the values."""
    points = gauss_nodes(nodes)
    values = legendre.legvander(points, nodes - 1)
    slopes = legendre.legval(points, legendre.legder(np.eye(nodes))).T
    return np.asarray(np.linalg.solve(values.T, slopes.T).T, np.float64)


@lru_cache(maxsize=64)
def _node_bases(count: int, degree: int) -> FloatArray:
    """Return (4, count, degree + 1): Legendre basis, two derivatives, integral from -1, at nodes.

    The integral is last, so that the index -1 selects it.
    """
    nodes = gauss_nodes(count)
    bases = np.empty((4, count, degree + 1))
    for column in range(degree + 1):
        unit = np.eye(degree + 1)[column]
        for order in range(3):
            bases[order, :, column] = legendre.legval(nodes, legendre.legder(unit, order))
        bases[-1, :, column] = legendre.legval(nodes, legendre.legint(unit, lbnd=-1))
    bases.setflags(write=False)
    return bases


class NodeFit:
    """Least-squares polynomial in one window, ready to be evaluated at the window's nodes.

    Values that depend on the instants alone are computed once for all channels sampled then.
    Windows with equal numbers of samples can be fitted as a stack, with the same results as one by
    one; every array then has the windows as its first axis.

    Parameters
    ----------
    t_s : (k,) sample times relative to the window's centre [s], or (windows, k)
    half_width_s : half the window [s]
    degree : degree of the polynomial, below k
    nodes : number of Gauss-Legendre nodes
    within : fit of a higher degree at the same instants; its factors contain those of this fit

    Attributes
    ----------
    degree, samples : degree of the polynomial; number k of instants

    Raises
    ------
    numpy.linalg.LinAlgError if the instants are too close together for the degree.
    """

    def __init__(
        self,
        t_s: FloatArray,
        half_width_s: float,
        degree: int,
        nodes: int,
        within: NodeFit | None = None,
    ) -> None:
        size = degree + 1
        self.degree, self.samples = degree, t_s.shape[-1]
        self._half_width_s = half_width_s
        self._bases = _node_bases(nodes, degree)
        if within is None:
            self._basis = legendre.legvander(t_s / half_width_s, degree)
            self._Q, R = np.linalg.qr(self._basis)
            self._R_inverse = np.asarray(np.linalg.solve(R, np.eye(size)), np.float64)
        else:
            self._basis, self._Q = within._basis[..., :size], within._Q[..., :size]  # noqa: SLF001
            self._R_inverse = within._R_inverse[..., :size, :size]  # noqa: SLF001
        self._solve = self._R_inverse @ self._Q.swapaxes(-1, -2)
        self._stacked: dict[tuple[int, ...], FloatArray] = {}
        self._unit: dict[tuple[int, ...], FloatArray] = {}  # covariances of noise with sigma one
        self._spectra: dict[tuple[int, ...], tuple[FloatArray, FloatArray]] = {}  # of `_unit`

    def coefficients(self, values: FloatArray) -> FloatArray:
        """Return Legendre coefficients (degree + 1, width) of samples (k, width)."""
        coefficients: FloatArray = self._solve @ values
        return coefficients

    def residuals(self, values: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Return samples minus polynomial, (k, width)."""
        return values - self._basis @ coefficients

    def operator(self, order: int) -> FloatArray:
        """Return (nodes, degree + 1): map of coefficients to `order`-th derivatives at the nodes.

        Order -1 is the integral from the window's start. The map is the same for every window.
        """
        scaled: FloatArray = self._bases[order] / self._half_width_s**order
        return scaled

    def operators(self, orders: tuple[int, ...]) -> FloatArray:
        """Return the operators of several derivatives, one below the other."""
        if orders not in self._stacked:
            self._stacked[orders] = np.concatenate([self.operator(order) for order in orders])
        return self._stacked[orders]

    def covariance(self, orders: tuple[int, ...], sigma: float) -> FloatArray:
        """Return the covariance of the stacked derivatives at the nodes, for white noise."""
        return sigma**2 * self.unit_covariance(orders)

    def unit_covariance(self, orders: tuple[int, ...]) -> FloatArray:
        """Return `covariance` for samples with a sigma of one."""
        if orders not in self._unit:
            E = self.operators(orders) @ self._R_inverse
            self._unit[orders] = E @ E.swapaxes(-1, -2)
        return self._unit[orders]

    def spectrum(self, orders: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
        """Return eigenvalues (orders x nodes) and eigenvectors of `unit_covariance`."""
        if orders not in self._spectra:
            values, vectors = np.linalg.eigh(self.unit_covariance(orders))
            self._spectra[orders] = values, vectors
        return self._spectra[orders]


class WindowFit:
    """The polynomial of one window of a stack.

    Attributes
    ----------
    fit : fit of the stack, or of this window alone
    at : index of the window in the stack
    """

    def __init__(self, fit: NodeFit, at: int | tuple[()] = ()) -> None:
        self.fit, self.at = fit, at

    def covariance(self, orders: tuple[int, ...], sigma: float) -> FloatArray:
        """Return the covariance of the stacked derivatives at the nodes, for white noise."""
        covariance: FloatArray = sigma**2 * self.fit.unit_covariance(orders)[self.at]
        return covariance

    def whitener(self, orders: tuple[int, ...]) -> FloatArray:
        """Return W (rank, orders x nodes) that whitens the derivatives of these orders, stacked.

        Their samples have unit noise. The rank is at most the polynomial's degree plus one.
        """
        values, vectors = (part[self.at] for part in self.fit.spectrum(orders))
        kept = values > RANK * values[-1]
        white: FloatArray = (vectors[:, kept] / np.sqrt(values[kept])).T
        return white


@lru_cache(maxsize=CACHED)
def node_fit(
    offsets_ns: bytes, windows: int, half_width_s: float, degree: int, nodes: int
) -> NodeFit:
    """Return the fit at instants that are given as int64 nanoseconds from the window's centre.

    The instants of several `windows`, equally many each, follow one another. On an exact grid all
    windows have the same instants except for missing samples; on a jittering grid every window has
    its own, and the fit is computed once for all channels.
    """
    return NodeFit(_seconds(offsets_ns, windows), half_width_s, degree, nodes)


@lru_cache(maxsize=CACHED)
def lower_fit(
    offsets_ns: bytes, windows: int, half_width_s: float, degree: int, nodes: int, higher: int
) -> NodeFit:
    """Return the fit of `degree`, whose factors are part of those of the `higher` degree."""
    within = node_fit(offsets_ns, windows, half_width_s, higher, nodes)
    return NodeFit(_seconds(offsets_ns, windows), half_width_s, degree, nodes, within)


def _seconds(offsets_ns: bytes, windows: int) -> FloatArray:
    t_s = np.frombuffer(offsets_ns, np.int64).astype(np.float64) * 1e-9
    return t_s if windows == 1 else t_s.reshape(windows, -1)
