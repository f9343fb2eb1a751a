"""Unwrap angles of encoders that read one turn only: a jump of 2 pi within noise is a wrap."""

from collections.abc import Sequence
from math import tau

import numpy as np

from fsw.messages import FloatArray


def unwrap(
    values: FloatArray,
    stamps_s: FloatArray,
    limits_rad_s: FloatArray,
    slack_rad: FloatArray,
    wraps: Sequence[bool | None],
) -> list[int]:
    """Unwrap angles in place, in order of time; return the number of wraps of each column.

    Parameters
    ----------
    values : (k, width) angles [rad]; what is not finite is left out
    stamps_s : (k,) their stamps [s], in any order
    limits_rad_s, slack_rad : (width,) greatest speed, and allowance beyond its motion
    wraps : whether a column wraps: every step beyond half a turn is a wrap, or none is; None: a
        step is a wrap if only a whole turn less brings it within the motion at the greatest speed
    """
    counts = [0] * values.shape[1]
    for k, declared in enumerate(wraps):
        rows = np.flatnonzero(np.isfinite(values[:, k]) & np.isfinite(stamps_s))
        rows = rows[np.argsort(stamps_s[rows], kind="stable")]
        if declared is False or len(rows) < 2:
            continue
        steps = np.diff(values[rows, k])
        turns = np.rint(steps / tau)
        if declared is None:
            allowed = slack_rad[k] + limits_rad_s[k] * np.diff(stamps_s[rows])
            is_wrap = (np.abs(steps) > allowed) & (np.abs(steps - tau * turns) <= allowed)
            turns[~is_wrap | (np.abs(turns) != 1.0)] = 0.0
        values[rows[1:], k] -= tau * np.cumsum(turns)
        counts[k] = int(np.count_nonzero(turns))
    return counts
