"""Sizes, rate and noise of samples; noise is what differences of a high order show.

That of encoders is what `fsw check` finds in the same samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fsw.estimators.conditioning.polynomial import EXTRA_DEGREE
from fsw.messages import FloatArray, IntArray
from offline.checks.noise import REST, motion_noise

DIFFERENCE = 4  # order of the differences that show noise, not motion
WINDOW_S = 0.4  # in which a joint moves or rests: the usual window
DEGREE = 3 + EXTRA_DEGREE  # of the polynomials of `fsw check` at the usual number of nodes
EQUAL = 1e-10  # difference of values that differ by the rounding of arithmetic alone
SPIKE_ROWS = 5  # the median of as many rows shows no spike of two
LEAST = 50  # least number of rows


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Sizes and noise of one joint in a recording [N m, rad/s, N m, rad]; 0: not known."""

    torque_nm: float = 0.0
    speed_rad_s: float = 0.0
    torque_noise_nm: float = 0.0
    position_noise_rad: float = 0.0


def sizes_of(
    t_s: FloatArray, q: FloatArray, tau: FloatArray | None, kinds: Sequence[str]
) -> list[Limits]:
    """Return sizes and noise of every joint, from whole rows that differ from the one before."""
    rows = in_order(t_s, q)
    t_s, q = t_s[rows], q[rows]
    noises = _encoder_noises(t_s, q, kinds)
    tau = None if tau is None else tau[rows]
    is_new = np.append(
        np.isfinite(t_s[:1]), (np.diff(q, axis=0) != 0.0).any(axis=1) & (np.diff(t_s) > 0.0)
    )
    t_s, q = t_s[is_new], q[is_new]
    tau = np.full_like(q, np.nan) if tau is None else tau[is_new]
    return [
        Limits(
            torque_nm=most(tau[:, k]),
            speed_rad_s=most(_speeds(t_s, q[:, k])),
            torque_noise_nm=white_noise(t_s, tau[:, k]),
            position_noise_rad=noises[k],
        )
        for k in range(q.shape[1])
    ]


def _encoder_noises(t_s: FloatArray, q: FloatArray, kinds: Sequence[str]) -> list[float]:
    """Return the noise of every joint's angles, of one at rest at least that of those that move.

    Rows that repeat count: they are samples too, of a sensor that is slower than its log.
    """
    t_ns = np.rint((t_s - t_s[:1]) * 1e9).astype(np.int64)
    rows = WINDOW_S / float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    piece = max(2 * DEGREE + 2, round(rows))
    cuts = np.arange(piece, len(t_s), piece)
    found = [
        motion_noise(
            list(zip(np.split(t_ns, cuts), np.split(one, cuts), strict=True)), DEGREE, REST
        )
        for one in q.T
    ]
    noises = [
        max(own.sigma, _step(one) / np.sqrt(12.0)) for own, one in zip(found, q.T, strict=True)
    ]
    for kind in set(kinds):
        own = [k for k, other in enumerate(kinds) if other == kind]
        moving = [noises[k] for k in own if found[k].moves] or [noises[k] for k in own]
        for k in own:
            noises[k] = noises[k] if found[k].moves else max(noises[k], *moving)
    return noises


def _speeds(t_s: FloatArray, q: FloatArray) -> FloatArray:
    """Return the speeds between rows in which a joint's encoder counts, of all if it is at rest."""
    counts = np.append(True, np.diff(q) != 0.0)[: len(q)]
    rows = counts if counts.sum() > LEAST else np.full(len(q), True)
    return np.asarray(np.abs(np.diff(q[rows])) / np.diff(t_s[rows]))


def in_order(t_s: FloatArray, values: FloatArray) -> IntArray:
    """Return the rows with a time and all values (k, axes), in order of time, one of each time."""
    rows = np.flatnonzero(np.isfinite(t_s) & np.isfinite(values).all(axis=1))
    return rows[np.unique(t_s[rows], return_index=True)[1]]


def most(values: FloatArray) -> float:
    """Return the size that 99.9 % of the values keep, without single spikes; 0: there are none.

    `values` are in order of time, (k,) or (k, axes).
    """
    columns = np.atleast_2d(values.T)
    sizes = [np.abs(own[np.isfinite(own)]) for own in columns if np.isfinite(own).any()]
    near = [sliding_window_view(own, min(SPIKE_ROWS, len(own))) for own in sizes]
    return float(max((np.quantile(np.median(own, axis=1), 0.999) for own in near), default=0.0))


def white_noise(t_s: FloatArray, values: FloatArray) -> float:
    """Return 1 sigma of white noise by divided differences of a high order; 0: none is seen.

    Logs have gaps, so that plain differences would show the motion. Values that repeat, as at rest
    or from a slower sensor, show no noise.
    """
    rows = in_order(t_s, values[:, None])
    values, t_s = values[rows], t_s[rows]
    if len(values) < LEAST:
        return 0.0
    near = sliding_window_view(np.arange(len(values)), DIFFERENCE + 1)
    apart = t_s[near][:, :, None] - t_s[near][:, None, :] + np.eye(DIFFERENCE + 1)
    weights = 1.0 / np.prod(apart / np.abs(apart).max(axis=(1, 2), keepdims=True), axis=2)
    found = np.sum(weights * values[near], axis=1) / np.linalg.norm(weights, axis=1)
    differs = np.ptp(values[near], axis=1) > 0.0
    return float(1.4826 * np.median(np.abs(found[differs]))) if differs.sum() >= LEAST else 0.0


def _step(values: FloatArray) -> float:
    """Return the step to which values are rounded: the least difference between two of them."""
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    return float(np.min(steps[steps > EQUAL], initial=np.inf)) if np.any(steps > EQUAL) else 0.0


def rate_of(t_s: FloatArray) -> float:
    """Return the rate of samples [Hz] with three digits, from the median of the steps."""
    return float(f"{1.0 / float(np.median(np.diff(np.unique(t_s[np.isfinite(t_s)])))):.3g}")


def noise_of(t_s: FloatArray, values: FloatArray | None) -> float:
    """Return 1 sigma of the white noise of a sensor of several axes (k, axes); 0: none is seen."""
    return 0.0 if values is None else max(white_noise(t_s, one) for one in values.T)


def noise_of_turns(t_s: FloatArray, q: FloatArray | None) -> float:
    """Return 1 sigma of the noise of attitude about an axis [rad]; q: quaternions (k, 4).

    A turn by a small angle v moves a unit quaternion by v / 2, in three of its four dimensions, so
    that the variances of the components have the sum 3 sigma^2 / 4.
    """
    if q is None:
        return 0.0
    same = np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)
    continuous = q * np.append(1.0, np.cumprod(same))[:, None]
    return float(np.sqrt(4.0 / 3.0 * sum(white_noise(t_s, one) ** 2 for one in continuous.T)))
