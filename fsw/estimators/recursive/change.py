"""Judging innovations: noise level, outliers, whiteness, and a change of what is estimated.

An outlier is one block whose normalised innovation squared (NIS) noise does not explain; a change
is a run of them, which Page's sum shows (`page_sum`).
Source: Basseville, Nikiforov, Detection of Abrupt Changes (1993), 2.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import chdtri

from fsw.estimators.noise.few_windows import FEW_WINDOWS, few_windows
from fsw.estimators.recursive import page_sum
from fsw.estimators.recursive.snapshot import Values, kept, put
from fsw.messages import FloatArray
from fsw.messages.false_alarms import per_test, sigmas

_STATE = ("nis", "nis_dof", "level", "doubt", "_sum", "_previous", "_lag", "_pairs")
SLOW_BLOCKS = 16  # 6.4 s at the default window: slower than any sensor, faster than a motion
SLOW_PROBABILITY = per_test("slow")
MISMATCH_LEVEL = 9.0  # ratio of variance to the declared one that no sensor's noise explains
COLOURED_SIGMAS = sigmas("colour")  # of white residuals' lag-1 correlation
COLOURED = 0.03  # least correlation between blocks that the conditioner's rounding does not explain
MEDIAN_LOSS = 1.25**2  # variance of a median over that of the mean
CHANGE_RATE = per_test("change")


@dataclass(frozen=True, slots=True)
class Judgement:
    """Whether the innovation of one block is accepted, and whether a change is detected."""

    accepted: bool
    changed: bool


def shared(group: Sequence[FloatArray], edges: Sequence[int]) -> Sequence[FloatArray]:
    """Return the residuals of all blocks of a group, or none if their rows are unlike.

    Where a block has no rows of an edge, because nothing was before it, the others' are left out.

    Parameters
    ----------
    group : residuals per block; the last `edges` of each are those of its edge
    """
    if any(len(rows) != len(group[0]) for rows in group):
        group = [rows[: len(rows) - edge] for rows, edge in zip(group, edges, strict=False)]
    return group if all(len(rows) == len(group[0]) for rows in group) else ()


def slow_power(
    residuals: Sequence[FloatArray], level: float, edges: Sequence[int] = ()
) -> tuple[float, float]:
    """Return the residuals' slow power over that of white noise, and its limit.

    Whitened residuals of SLOW_BLOCKS successive blocks are summed and divided by the root of their
    number. If they are white, the sum has unit variance; a slower drift has up to SLOW_BLOCKS times
    as much. Effects that no parameter of rigid bodies explains and that are not noise, as sloshing
    liquid, show here long before they show in the level. White residuals exceed the limit with
    SLOW_PROBABILITY at most, because fitting only removes slow power. Source: batch means, Box,
    Jenkins, Time Series Analysis (1976), 2.1.

    Parameters
    ----------
    residuals : per block, oldest first; a group with blocks of unlike rows is left out
    level : ratio of the noise's variance to the declared one
    edges : see `shared`
    """
    total, dof = 0.0, 0
    edges = edges or [0] * len(residuals)
    for first in range(0, len(residuals) - SLOW_BLOCKS + 1, SLOW_BLOCKS):
        own = slice(first, first + SLOW_BLOCKS)
        group = shared(residuals[own], edges[own])
        if not len(group):
            continue
        mean = np.sum(group, axis=0)
        total += float(mean @ mean) / SLOW_BLOCKS
        dof += len(mean)
    if dof == 0:
        return 1.0, float("inf")
    return total / dof / level, float(chdtri(dof, SLOW_PROBABILITY)) / dof


def colour(residuals: Sequence[FloatArray], edges: Sequence[int] = ()) -> tuple[float, float]:
    """Return the lag-1 correlation of the residuals of successive blocks, and its limit.

    Residuals of a correct model are white. Those of a wrong model are alike from block to block, as
    the motion is. Fitting makes the correlation of a correct model slightly negative. Residuals
    smaller than the declared noise, as at rest, are compared with this noise.

    Parameters
    ----------
    residuals : whitened, per block, oldest first; pairs of unlike rows are left out
    edges : see `shared`
    """
    edges = edges or [0] * len(residuals)
    both = zip(pairwise(residuals), pairwise(edges), strict=True)
    pairs = [pair for pair in (shared(rows, own) for rows, own in both) if len(pair)]
    power = sum(0.5 * float(a @ a + b @ b) for a, b in pairs)
    count = sum(len(a) for a, _ in pairs)
    if count == 0:
        return 0.0, 1.0
    power = max(power, float(count))
    limit = max(COLOURED, COLOURED_SIGMAS / float(np.sqrt(count)))
    return sum(float(a @ b) for a, b in pairs) / power, min(1.0, limit)


class InnovationMonitor:
    """Running statistics of the whitened innovations of one estimator.

    Attributes
    ----------
    nis, nis_dof : normalised innovation squared of the newest block and its degrees of freedom
    level : ratio of the noise variance to the declared one; 1 unless the residuals clearly show
        more, or few windows of a held arm show any more
    doubt : Student's factor on this variance, because few windows have shown it; 1: it is not used
    step : what the newest block added to Page's sum, whose limit is 1; 0: it was not judged
    """

    def __init__(self, gate_probability: float) -> None:
        self._gate_probability = gate_probability
        self.nis, self.nis_dof = 0.0, 0
        self.level = self.doubt = 1.0
        self.step = 0.0
        self._sum = 0.0
        self._previous: FloatArray | None = None
        self._lag = np.zeros(2)  # sum of products of successive innovations; of their squares
        self._pairs = 0

    @property
    def variance(self) -> float:
        """Return the factor on the declared noise variance that a covariance must count."""
        return self.level * self.doubt

    def snapshot(self) -> dict[str, Any]:
        """Return the state as plain values."""
        return kept(self, _STATE)

    def restore(self, values: Values) -> None:
        """Continue from a snapshot."""
        put(self, _STATE, values)

    def restart(self) -> None:
        """Discard the sum of excesses; keep noise level and whiteness, which are the sensors'."""
        self._sum = 0.0
        self._previous = None

    def judge(self, white: FloatArray, *, armed: bool) -> Judgement:
        """Judge the next block's innovation, whitened to unit covariance under a correct model.

        While `armed` is False (not settled), every innovation is accepted and none is summed.
        """
        dof = len(white)
        self.nis, self.nis_dof, self.step = float(white @ white), dof, 0.0
        if not armed or dof == 0:
            self._previous = None
            return Judgement(True, False)
        nis = self.nis / self.level
        self.step = page_sum.step(nis, dof, CHANGE_RATE)
        self._sum = max(0.0, self._sum + self.step)
        accepted = bool(nis <= chdtri(dof, self._gate_probability))
        if accepted:
            self._correlate(white)
        else:
            self._previous = None
        return Judgement(accepted, self._sum > 1.0)

    def learn_level(
        self, levels: FloatArray, dof: int, parameters: float, *, is_held: bool = False
    ) -> None:
        """Set the noise level from the mean squared residuals of the newest blocks.

        The level is their median, corrected for the parameters fitted; one unless it stands out: a
        median of chi-square means has MEDIAN_LOSS times the variance of their mean. With `is_held`,
        of a base that is held, few blocks are judged as `few_windows` says.
        """
        count = len(levels)
        self.doubt = 1.0
        if is_held and 0 < count < FEW_WINDOWS:
            self.level, self.doubt = few_windows(levels, parameters, dof)
            return
        spare = count * dof - parameters
        if count < 4 or spare <= 0:
            return
        level = float(np.median(levels)) * count * dof / spare
        alike = spare / MEDIAN_LOSS
        self.level = level if level > chdtri(alike, per_test("level")) / alike else 1.0

    def whiteness(self) -> tuple[float, float]:
        """Return the lag-1 correlation of the innovations and its 99.9 % bound if white."""
        if self._pairs == 0:
            return 0.0, 1.0
        return float(self._lag[0] / self._lag[1]), min(1.0, 3.29 / float(np.sqrt(self._pairs)))

    def _correlate(self, white: FloatArray) -> None:
        before, self._previous = self._previous, white
        if before is not None and len(before) == len(white):
            power = 0.5 * (white @ white + before @ before)
            self._lag += (float(white @ before), float(power))
            self._pairs += len(white)
