"""Local polynomials: one window of samples to values and derivatives at Gauss-Legendre nodes.

A least-squares polynomial of degree m-1 evaluated at the m Gauss-Legendre nodes of its window gives
m uncorrelated values that hold all of its information (the discrete analogue of Gauss quadrature),
and its truncation error of order m vanishes at just those nodes. So a window becomes m independent
samples, and nothing is counted twice.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from fsw.messages import FloatArray


@lru_cache(maxsize=16)
def gauss_nodes(count: int) -> FloatArray:
    """Return the `count` Gauss-Legendre nodes in (-1, 1), ascending."""
    nodes: FloatArray = legendre.leggauss(count)[0]
    nodes.setflags(write=False)
    return nodes


@lru_cache(maxsize=64)
def _node_bases(count: int, degree: int) -> FloatArray:
    """Return (3, count, degree + 1): Legendre basis and its two derivatives at the nodes."""
    nodes = gauss_nodes(count)
    bases = np.empty((3, count, degree + 1))
    for column in range(degree + 1):
        unit = np.eye(degree + 1)[column]
        for order in range(3):
            bases[order, :, column] = legendre.legval(nodes, legendre.legder(unit, order))
    bases.setflags(write=False)
    return bases


class NodeFit:
    """Least-squares polynomial in one window, ready to be evaluated at the window's nodes.

    Parameters
    ----------
    t_s : (k,) sample times relative to the window's centre [s]
    half_width_s : half the window [s]
    degree : of the polynomial, k > degree
    nodes : number of Gauss-Legendre nodes
    """

    def __init__(self, t_s: FloatArray, half_width_s: float, degree: int, nodes: int) -> None:
        self._half_width_s = half_width_s
        self._bases = _node_bases(nodes, degree)
        self._basis = legendre.legvander(t_s / half_width_s, degree)
        Q, R = np.linalg.qr(self._basis)
        self._R_inverse = np.linalg.solve(R, np.eye(degree + 1))
        self._solve = self._R_inverse @ Q.T
        self._unit: dict[tuple[int, ...], FloatArray] = {}  # covariances of noise with sigma one

    def coefficients(self, values: FloatArray) -> FloatArray:
        """Return Legendre coefficients (degree + 1, width) of samples (k, width)."""
        coefficients: FloatArray = self._solve @ values
        return coefficients

    def residuals(self, values: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Return samples minus polynomial, (k, width)."""
        return values - self._basis @ coefficients

    def operator(self, order: int) -> FloatArray:
        """Return (nodes, degree + 1): coefficients to the `order`-th derivative at the nodes."""
        scaled: FloatArray = self._bases[order] / self._half_width_s**order
        return scaled

    def covariance(self, orders: tuple[int, ...], sigma: float) -> FloatArray:
        """Return the covariance of the stacked derivatives at the nodes, for white samples."""
        if orders not in self._unit:
            E = np.concatenate([self.operator(order) for order in orders]) @ self._R_inverse
            self._unit[orders] = E @ E.T
        return sigma**2 * self._unit[orders]
