"""Polynomial fits of the channels of windows, without outliers.

Channels sampled at the same instants are fitted in one matrix product, and so are windows with
equal numbers of samples. A channel with outliers is fitted again without them. Outliers are judged
by their distance from the window's own polynomial. A window's fit does not depend on the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fsw.estimators.conditioning.polynomial import NodeFit, WindowFit, lower_fit, node_fit
from fsw.estimators.noise.found import LAGS, gapped_products, mean_products
from fsw.messages import FloatArray, false_alarms

GATE_SIGMAS = false_alarms.sigmas("sample", sides=2)  # of white noise
MAX_PASSES = 12  # of removing outliers and fitting again; a window that needs more is not used


@dataclass(frozen=True, slots=True, eq=False)
class ChannelFit:
    """A channel at the nodes without its outliers; `fit` is None if no polynomial is possible."""

    fit: WindowFit | None
    values: FloatArray  # (derivatives times nodes, width)
    removed: int
    left: tuple[float, float] = (0.0, 0.0)  # mean products of residuals 0 and 1 samples apart

    def covariance(self, orders: tuple[int, ...], sigma: float, rows: int) -> FloatArray:
        """Return the covariance (rows, rows) of one axis; the identity if there is no fit."""
        return np.eye(rows) if self.fit is None else self.fit.covariance(orders, sigma)


NO_FIT = ChannelFit(None, np.empty(0), 0)


@dataclass(frozen=True, slots=True)
class Instants:
    """Instants at which channels of one or more windows were sampled, equally many per window.

    `degree` is the highest that is fitted; fits of lower degrees share its factorisation.
    """

    offsets_ns: bytes  # int64, from the window's centre, window by window
    half_s: float
    nodes: int
    degree: int
    windows: int = 1

    def fit(self, degree: int) -> NodeFit:
        """Return the polynomial fit of a degree at all instants."""
        own = self.offsets_ns, self.windows, self.half_s
        if degree == self.degree:
            return node_fit(*own, degree, self.nodes)
        return lower_fit(*own, degree, self.nodes, self.degree)

    def kept(self, keep: NDArray[np.bool_], degree: int) -> Self:
        """Return the instants of one window where `keep` is True, as if there were no others."""
        offsets_ns = np.frombuffer(self.offsets_ns, np.int64)[keep].tobytes()
        high = self.degree if keep.sum() > self.degree + 1 else degree
        return type(self)(offsets_ns, self.half_s, self.nodes, high)


@dataclass(frozen=True, slots=True, eq=False)
class Wanted:
    """Channels of one window that are fitted alike.

    Attributes
    ----------
    values : (k, channels times width) samples; rows that are not finite are not used
    sigmas : (channels,) noise of a sample, by which outliers are judged
    orders : orders of the derivatives wanted at the nodes
    min_fill : share of the samples that must be finite
    samples : periods in a window, if mean products of the highest polynomial's residuals are
        wanted; 0: they are not
    """

    instants: Instants  # of one window
    values: FloatArray
    sigmas: FloatArray
    degree: int
    orders: tuple[int, ...]
    width: int = 1
    min_fill: float = 0.0
    samples: int = 0

    @property
    def kind(self) -> tuple[object, ...]:
        """Return a key that is equal for all that can be fitted at once."""
        at = self.instants
        own = len(at.offsets_ns), at.half_s, at.nodes, at.degree, self.values.shape[1]
        return *own, self.degree, self.orders, self.width, self.samples


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """The fits of the channels of one `Wanted`.

    Attributes
    ----------
    samples : number of samples of each channel in the window
    products : (L, columns) mean products of the highest polynomial's residuals; zero where a sample
        is not finite, or two lie in one period of the window, and where none are wanted
    """

    channels: Sequence[ChannelFit]
    samples: int
    products: FloatArray


def fit_windows(wanted: Sequence[Wanted]) -> list[Fitted]:
    """Return the fits of any windows, in order; channels of one kind share one matrix product."""
    alike: dict[tuple[object, ...], list[int]] = {}
    for place, own in enumerate(wanted):
        alike.setdefault(own.kind, []).append(place)
    found: list[Fitted | None] = [None] * len(wanted)
    for places in alike.values():
        group = [wanted[place] for place in places]
        for place, fitted in zip(places, _fit_alike(group), strict=True):
            found[place] = fitted
    return [fitted for fitted in found if fitted is not None]


def _fit_alike(group: Sequence[Wanted]) -> list[Fitted]:
    """Return the fits of one kind; windows whose instants are too close together have no fit."""
    first, instants = group[0], _stacked([own.instants for own in group])
    orders, width = first.orders, first.width
    try:
        fit = instants.fit(first.degree)
    except np.linalg.LinAlgError:
        if len(group) > 1:
            return [fitted for own in group for fitted in _fit_alike([own])]
        samples, columns = first.values.shape
        return [Fitted([NO_FIT] * len(first.sigmas), samples, np.zeros((len(LAGS), columns)))]
    values, sigmas = first.values[None], first.sigmas
    if len(group) > 1:
        values, sigmas = np.stack([w.values for w in group]), np.stack([w.sigmas for w in group])
    coefficients = fit.coefficients(values)
    left = fit.residuals(values, coefficients)
    worst = np.abs(left).max(axis=1)
    power = _powers(left).reshape(len(group), 2, -1, width).sum(axis=3)
    clean = worst.reshape(len(group), -1, width).max(axis=2) <= GATE_SIGMAS * sigmas
    at_nodes = fit.operators(orders) @ coefficients
    products = _products(group, instants, values)
    found = []
    rows = zip(group, at_nodes, clean.tolist(), strict=True)
    for at, (own, columns, are_clean) in enumerate(rows):
        window_fit = WindowFit(fit, at if instants.windows > 1 else ())
        channels = [
            ChannelFit(
                window_fit, columns[:, i * width : (i + 1) * width], 0, tuple(power[at, :, i])
            )
            if is_clean
            else _robust(own, i)
            for i, is_clean in enumerate(are_clean)
        ]
        found.append(Fitted(channels, len(own.values), products[at]))
    return found


def _stacked(windows: Sequence[Instants]) -> Instants:
    """Return the instants of all windows, or those of one if they are equal in all."""
    first, parts = windows[0], [own.offsets_ns for own in windows]
    if parts.count(parts[0]) == len(parts):
        return first
    return Instants(b"".join(parts), first.half_s, first.nodes, first.degree, len(parts))


def _products(group: Sequence[Wanted], instants: Instants, values: FloatArray) -> FloatArray:
    """Return `Fitted.products` (windows, L, columns) of samples (windows, k, columns)."""
    B, k, columns = values.shape
    found, samples = np.zeros((B, len(LAGS), columns)), group[0].samples
    if not samples:
        return found
    period_ns = 2e9 * instants.half_s / samples
    offsets_ns = np.frombuffer(b"".join(own.instants.offsets_ns for own in group), np.int64)
    since_ns = offsets_ns.reshape(B, k) - offsets_ns.reshape(B, k)[:, :1]
    place = np.rint(since_ns / period_ns).astype(np.int64)
    steps = place[:, 1:] - place[:, :-1]
    least = steps.min(axis=1)
    whole = (least == 1) & (steps.max(axis=1) == 1)
    fit = instants.fit(instants.degree)
    with np.errstate(invalid="ignore", over="ignore"):
        left = fit.residuals(values, fit.coefficients(values))
        if whole.any():
            side_by_side = left[whole].transpose(1, 0, 2).reshape(k, -1)
            own = mean_products(side_by_side).reshape(len(LAGS), -1, columns)
            found[whole] = own.transpose(1, 0, 2)
        for at in np.flatnonzero((least >= 1) & ~whole).tolist():
            found[at] = gapped_products(left[at], place[at])
    return found if np.isfinite(found).all() else np.nan_to_num(found, posinf=0.0, neginf=0.0)


def _powers(left: FloatArray) -> FloatArray:
    """Return the mean products (..., 2, c) of residuals (..., k, c) 0 and 1 samples apart."""
    later = np.concatenate([left[..., 1:, :], np.zeros_like(left[..., :1, :])], axis=-2)
    k = left.shape[-2]
    found: FloatArray = np.stack([(left * own).sum(axis=-2) / k for own in (left, later)], axis=-2)
    return found


def _robust(own: Wanted, channel: int) -> ChannelFit:
    """Fit one channel (k, width), leaving outliers out."""
    degree, sigma = own.degree, own.sigmas[channel]
    values = own.values[:, channel * own.width : (channel + 1) * own.width]
    least, removed = 2 * (degree + 1), 0
    keep = np.asarray(np.isfinite(values).all(axis=1))
    if not keep.all() and keep.sum() < max(own.min_fill * len(keep), least):
        return NO_FIT
    for _ in range(MAX_PASSES):
        instants = own.instants if keep.all() else own.instants.kept(keep, degree)
        fit = instants.fit(degree)
        coefficients = fit.coefficients(values[keep])
        left = fit.residuals(values[keep], coefficients)
        good = _inliers(left, sigma)
        if good.all():
            at_nodes, power = fit.operators(own.orders) @ coefficients, _powers(left).sum(axis=1)
            return ChannelFit(WindowFit(fit), at_nodes, removed, tuple(power))
        removed += int(np.sum(~good))
        keep[keep] = good
        if keep.sum() < least:
            break
    return ChannelFit(None, np.empty(0), removed)


def _inliers(residuals: FloatArray, sigma: float) -> np.ndarray:
    """Return (k,) whether samples lie within the gate on every axis.

    The scale is the larger of the declared noise and the window's own median deviation, so that a
    noisier sensor than declared degrades instead of losing every sample. The worst outliers are
    removed first: they bend the fit, and good samples near them must not be removed too.
    """
    size = np.abs(residuals)
    middle = len(size) // 2
    median = np.partition(size, middle, axis=0)[middle]  # np.median is ten times as slow
    ratio = np.max(size / np.maximum(sigma, 1.4826 * median), axis=1)
    good: np.ndarray = ratio <= np.maximum(GATE_SIGMAS, 0.5 * ratio.max())
    return good
