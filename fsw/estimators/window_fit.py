"""Polynomials through the channels of one window that share their instants, without outliers.

Channels sampled at the same instants are fitted in one matrix product; one with outliers is fitted
again without them. Outliers are judged by their distance from the window's own polynomial.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.estimators.found_noise import LAGS, gapped_products, mean_products
from fsw.estimators.polynomial import NodeFit, lower_fit, node_fit
from fsw.messages import FloatArray

GATE_SIGMAS = 6.0  # one false alarm in 5e8 white samples
MAX_PASSES = 12  # of removing outliers and fitting again; a window that needs more is junk


@dataclass(frozen=True, slots=True, eq=False)
class ChannelFit:
    """A channel at the nodes without its outliers; fit None: no polynomial can be had."""

    fit: NodeFit | None
    values: FloatArray  # (derivatives times nodes, width)
    removed: int

    def covariance(self, orders: tuple[int, ...], sigma: float, rows: int) -> FloatArray:
        """Return the covariance of one axis; the unit (rows, rows) stands for a missing one."""
        return np.eye(rows) if self.fit is None else self.fit.covariance(orders, sigma)


NO_FIT = ChannelFit(None, np.empty(0), 0)


@dataclass(frozen=True, slots=True)
class Instants:
    """The instants at which some channels were sampled.

    `degree` is the highest that is fitted: the others share its factorisation.
    """

    offsets_ns: bytes  # int64, from the window's centre
    half_s: float
    nodes: int
    degree: int

    def fitted(
        self,
        values: FloatArray,
        sigmas: FloatArray,
        degree: int,
        orders: tuple[int, ...],
        *,
        width: int = 1,
        min_fill: float = 0.0,
    ) -> list[ChannelFit]:
        """Fit channels, all in one product; those with an outlier again.

        Parameters
        ----------
        values : (k, channels times width) samples; rows that are not finite are not used
        sigmas : (channels,) by which outliers are judged: noise of a sample
        orders : of the derivatives wanted at the nodes
        min_fill : share of the samples that must be finite
        """
        fit = self._fit(degree)
        coefficients = fit.coefficients(values)
        worst = np.abs(fit.residuals(values, coefficients)).max(axis=0)
        clean = worst.reshape(-1, width).max(axis=1) <= GATE_SIGMAS * sigmas
        at_nodes, found = fit.operators(orders) @ coefficients, list[ChannelFit]()
        for i, is_clean in enumerate(clean.tolist()):
            own = slice(i * width, (i + 1) * width)
            if is_clean:
                found.append(ChannelFit(fit, at_nodes[:, own], 0))
            else:
                found.append(self._robust(values[:, own], sigmas[i], degree, orders, min_fill))
        return found

    def products(self, values: FloatArray, samples: int) -> FloatArray:
        """Return the mean products (L, k) of what the highest polynomial leaves of channels.

        Zero where a sample is not finite, or two lie in the same of the window's `samples` periods.
        """
        fit = self._fit(self.degree)
        with np.errstate(invalid="ignore", over="ignore"):
            left = fit.residuals(values, fit.coefficients(values))
            period_ns = 2e9 * self.half_s / samples
            offsets_ns = np.frombuffer(self.offsets_ns, np.int64)
            place = np.rint((offsets_ns - offsets_ns[0]) / period_ns).astype(np.int64)
            steps = np.diff(place)
            if (steps < 1).any():
                return np.zeros((len(LAGS), left.shape[1]))
            products = mean_products(left) if (steps == 1).all() else gapped_products(left, place)
        whole = bool(np.isfinite(products).all())
        return products if whole else np.nan_to_num(products, nan=0.0, posinf=0.0, neginf=0.0)

    def _fit(self, degree: int, keep: NDArray[np.bool_] | None = None) -> NodeFit:
        """Return the fit of all instants, or of those to keep as if there were no others."""
        offsets_ns, high = self.offsets_ns, self.degree
        if keep is not None:
            offsets_ns = np.frombuffer(offsets_ns, np.int64)[keep].tobytes()
            high = high if keep.sum() > high + 1 else degree
        if degree == high:
            return node_fit(offsets_ns, self.half_s, degree, self.nodes)
        return lower_fit(offsets_ns, self.half_s, degree, self.nodes, high)

    def _robust(
        self,
        values: FloatArray,
        sigma: float,
        degree: int,
        orders: tuple[int, ...],
        min_fill: float,
    ) -> ChannelFit:
        """Fit one channel (k, width), leaving outliers out."""
        least, removed = 2 * (degree + 1), 0
        keep = np.asarray(np.isfinite(values).all(axis=1))
        if not keep.all() and keep.sum() < max(min_fill * len(keep), least):
            return NO_FIT
        for _ in range(MAX_PASSES):
            fit = self._fit(degree, None if keep.all() else keep)
            coefficients = fit.coefficients(values[keep])
            good = _inliers(fit.residuals(values[keep], coefficients), sigma)
            if good.all():
                return ChannelFit(fit, fit.operators(orders) @ coefficients, removed)
            removed += int(np.sum(~good))
            keep[keep] = good
            if keep.sum() < least:
                break
        return ChannelFit(None, np.empty(0), removed)


def _inliers(residuals: FloatArray, sigma: float) -> np.ndarray:
    """Return (k,) which samples lie within the gate on every axis.

    The scale is the larger of the declared noise and the window's own median deviation, so that a
    noisier sensor than declared degrades instead of losing every sample. The worst go first: an
    outlier bends the fit, and good samples near it must not be left out with it.
    """
    size = np.abs(residuals)
    middle = len(size) // 2
    median = np.partition(size, middle, axis=0)[middle]  # np.median is ten times as slow
    ratio = np.max(size / np.maximum(sigma, 1.4826 * median), axis=1)
    good: np.ndarray = ratio <= np.maximum(GATE_SIGMAS, 0.5 * ratio.max())
    return good
