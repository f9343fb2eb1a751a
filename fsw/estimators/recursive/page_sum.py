"""Page's cumulative sum of chi-square excess, and the threshold for a wanted rate of false alarms.

A block's excess is (NIS - dof) / sqrt(2 dof), capped; the sum over blocks of excess minus a drift,
never below zero, raises an alarm above a threshold. Its mean time to a false alarm L(s) from a sum
s solves L(s) = 1 + E[L(max(0, s + excess - drift)); no alarm]. The sum is divided into cells, whose
transitions follow from the chi-square distribution, so that L solves a linear system. Sources:
Page, Biometrika 41 (1954); Brook, Evans, Biometrika 59 (1972), for the Markov chain.
"""

from functools import lru_cache

import numpy as np
from scipy.special import chdtr

from fsw.messages import FloatArray

DRIFT = 1.0  # standard deviations subtracted per block
CELLS = 120
LEAST = 2.5 * DRIFT  # below it, the cap would be no more than the drift
REACH = 0.5  # of the threshold: most that one block's excess counts; one is no alarm
TOLERANCE = 0.01  # of the logarithm of the rate


def step(nis: float, dof: int, rate: float) -> float:
    """Return what a block adds to the sum, in units of the limit.

    Parameters
    ----------
    nis, dof : normalised innovation squared of the block, and its number of rows
    rate : false alarms per clean block, which fixes the limit for blocks of `dof` rows
    """
    limit = threshold(dof, rate)
    return float(min((nis - dof) / np.sqrt(2.0 * dof), REACH * limit) - DRIFT) / limit


def mean_blocks_to_alarm(dof: int, limit: float, cells: int = CELLS) -> float:
    """Return the mean number of clean blocks until the sum, from zero on, exceeds the limit."""
    width = limit / (cells - 0.5)  # cell k is centred on k width; the first one is half as wide
    cell = np.arange(cells)
    edges = np.asarray(width * (np.arange(1 - cells, cells) + 0.5), np.float64)
    below = _below(dof, limit, edges)[cell - cell[:, None] + cells - 1]
    Q = np.diff(below, axis=1, prepend=0.0)
    return float(np.linalg.solve(np.eye(cells) - Q, np.ones(cells))[0])


def _below(dof: int, limit: float, step: FloatArray) -> FloatArray:
    """Return the probability that the sum changes by less than `step` by a clean block."""
    raw = step + DRIFT
    nis = dof + raw * np.sqrt(2.0 * dof)
    free = chdtr(dof, np.maximum(nis, 0.0))
    return np.asarray(np.where(raw > REACH * limit, 1.0, free), np.float64)


@lru_cache(maxsize=256)
def threshold(dof: int, rate: float) -> float:
    """Return the limit of the sum that clean blocks of `dof` rows exceed at `rate` per block.

    The logarithm of the rate is nearly linear in the limit, so that secants find it.
    """
    a, b = 8.0, 12.0
    fa, fb = (_miss(dof, limit, rate) for limit in (a, b))
    for _ in range(20):
        if abs(fb) < TOLERANCE:
            break
        a, b, fa = b, max(LEAST, b - fb * (b - a) / (fb - fa)), fb
        fb = _miss(dof, b, rate)
    return b


def _miss(dof: int, limit: float, rate: float) -> float:
    """Return the logarithm of the limit's rate over the wanted one, negated."""
    return float(np.log(mean_blocks_to_alarm(dof, limit) * rate))
