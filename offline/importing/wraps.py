"""Unwrap angles of encoders that read one turn only: a jump of 2 pi within noise is a wrap."""

from collections.abc import Sequence
from math import pi, tau

import numpy as np

from fsw.messages import FloatArray

USUAL_SHARE = 0.99  # share of the steps that are motion, not faults
USUAL_TIMES = 3.0  # a step of motion is at most this many times the fastest usual one
SOUND_RAD = pi / 4.0  # a speed limit that allows more between samples is a placeholder


def unwrap(
    values: FloatArray,
    stamps_s: FloatArray,
    limits_rad_s: FloatArray,
    noise_rad: FloatArray,
    wraps: Sequence[bool | None],
) -> list[int]:
    """Unwrap angles in place, in order of time; return the number of wraps of each column.

    Parameters
    ----------
    values : (k, width) angles [rad]; what is not finite is left out
    stamps_s : (k,) their stamps [s], in any order
    limits_rad_s, noise_rad : (width,) greatest speed, and greatest error of a step
    wraps : whether a column wraps: every step beyond half a turn is a wrap, or none is; None: a
        step is a wrap if this joint cannot make it, and could with a whole turn less
    """
    counts = [0] * values.shape[1]
    for k, declared in enumerate(wraps):
        rows = np.flatnonzero(np.isfinite(values[:, k]) & np.isfinite(stamps_s))
        rows = rows[np.argsort(stamps_s[rows], kind="stable")]
        if declared is False or len(rows) < 2:
            continue
        steps, steps_s = np.diff(values[rows, k]), np.diff(stamps_s[rows])
        turns = np.rint(steps / tau)
        if declared is None:
            rest = np.abs(steps - tau * turns)
            motion = noise_rad[k] + _motion(rest, steps_s, float(limits_rad_s[k]))
            is_wrap = (np.abs(steps) > motion) & (rest <= motion) & (motion < pi)
            turns[~is_wrap | (np.abs(turns) != 1.0)] = 0.0
        values[rows[1:], k] -= tau * np.cumsum(turns)
        counts[k] = int(np.count_nonzero(turns))
    return counts


def _motion(rest: FloatArray, steps_s: FloatArray, limit_rad_s: float) -> FloatArray:
    """Return how far the joint may move in each step [rad], by its data and its speed limit.

    A limit that is too low or a placeholder must not decide, so that the usual speed counts too.
    """
    period_s = float(np.median(steps_s))
    if period_s <= 0.0:
        return np.full(len(rest), pi)
    usual = float(np.quantile(rest / np.maximum(steps_s, period_s), USUAL_SHARE))
    speed = USUAL_TIMES * usual
    if 2.0 * limit_rad_s * period_s < SOUND_RAD:
        speed = max(speed, limit_rad_s)
    return speed * (steps_s + period_s)
