"""Whether the model fits the data so far, and how long it must fit again after it did not.

A model that does not fit re-opens the estimate, as a change of bodies does. Any model fits the
first few blocks, so the same wrong model would soon be trusted again. If the mismatch lasted before
the re-opening, or if the last re-opening was not long ago, the new estimate must fit for longer.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, Protocol

import numpy as np

from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.model.problem import Problem
from fsw.estimators.noise.creep import Creep
from fsw.estimators.noise.likeness import (
    Likeness,
    besides_torques,
    lasting,
    likeness,
    unexplained,
    widened,
)
from fsw.estimators.recursive.change import MISMATCH_LEVEL, colour, slow_power
from fsw.estimators.recursive.snapshot import Values, kept, put
from fsw.messages import Block, FloatArray

LASTING_BLOCKS = 4  # blocks of mismatch before a re-opening; a change of bodies is found sooner
SUSPECT_BLOCKS = 64  # blocks that a model must fit after a mismatch before it is trusted again
REPEATS = 0.5  # share of a correlation's limit above which repetitions are counted; this is cheap
UNEXPLAINED = 0.05  # share of a held arm's torques that may be unmodelled friction and the like
CREPT = "what changed before the estimate was re-opened crept, as a sensor does"
GATED_SHARE = 0.25  # of the blocks; if more do not fit, they are not outliers
_STATE = (
    *(
        "_judged",
        "_left_out",
        "unexplained",
        "_lasting",
        "slow",
        "colour",
        "alike",
        "excess",
        "against",
    ),
    *("suspect", "creep", "creeping", "crept"),
)


class Cost(Protocol):
    """Computes the cost of likeness; `repeats`: residuals repeat with the motion."""

    def __call__(self, *, repeats: bool) -> Likeness:
        """Return the cost."""
        ...


class Trust:
    """Judgement of one estimate's residuals, and the suspicion that its predecessor left.

    Attributes
    ----------
    slow, colour : the residuals' slow power, and correlation between blocks, each with its limit
    alike : whether one of them is beyond its limit
    excess : (p, p) long-run covariance of the score that the residuals' likeness adds; None: white
    unexplained : rms of the residual torques over that of the torques, on a base that is held
    against : what neither noise nor likeness explains in the residuals; empty: nothing
    creep : (p, p) by how much a change that seems to be under way moves the estimate, squared
    creeping : which change chance does not explain, where it does harm; empty: none
    crept : the same of the estimate before the re-opening, whose sensors this one has
    suspect : whether the model had not fitted when the estimate was re-opened, or the data have
        contradicted the prior of a sensor, a known body or a mounting
    """

    def __init__(self, *, suspect: bool = False) -> None:
        self.slow, self.colour = (1.0, float("inf")), (0.0, 1.0)
        self.excess: FloatArray | None = None
        self.against = self.creeping = self.crept = ""
        self.alike = False
        self.creep: FloatArray | None = None
        self.unexplained = float("inf")
        self._judged = self._left_out = 0  # numbers of blocks
        self.suspect, self._lasting = suspect, 0  # successive blocks with a mismatch

    def judge(
        self,
        problem: Problem,
        rows: Collection[Rows],
        blocks: Sequence[Block],
        level: float,
        white: FloatArray,
        doubt: float = 1.0,
    ) -> None:
        """Judge the rows of blocks at their estimate, oldest first.

        Parameters
        ----------
        level : ratio of the noise's variance to the declared one
        white : (p, p) covariance of the estimate if the residuals are white
        doubt : factor on the noise's variance in `white`, because few windows have shown it
        """
        nodes, is_free = problem.nodes, problem.is_free
        parts = [(one.b.copy(), one.torques, one.edge) for one in rows]
        residuals, torques = [b for b, _, _ in parts], [count for _, count, _ in parts]
        edges = [edge for _, _, edge in parts]
        besides = residuals
        if not is_free:
            besides = besides_torques(residuals, torques, nodes, edges)
        self.unexplained = float("inf") if is_free else unexplained(rows, blocks, nodes)

        def cost(*, repeats: bool) -> Likeness:
            A = [doubt**-0.5 * one.A for one in rows]
            return likeness(A, residuals, white, level, nodes, edges, repeats=repeats)

        self.learn(residuals, level, besides, cost, edges, few=doubt > 1.0)

    def watch(self, change: Creep | None) -> None:
        """Judge the worst change that the residuals show, if they show any."""
        self.creep = None if change is None else change.excess
        if change is None:
            self.creeping = ""
        elif change.is_refused:
            self.creeping = change.words()

    def learn(
        self,
        residuals: Sequence[FloatArray],
        level: float,
        besides: Sequence[FloatArray] = (),
        cost: Cost | None = None,
        edges: Sequence[int] = (),
        *,
        few: bool = False,
    ) -> None:
        """Judge whitened residuals, block by block, oldest first.

        Parameters
        ----------
        level : ratio of the noise's variance to the declared one
        besides : residuals of the rows that are not torques and therefore must be white
        cost : computes what likeness costs; called where the residuals are alike
        edges : number of last rows per block that are those of its edge
        few : whether the blocks are too few for a test of likeness; its cost then counts anyway
        """
        self.slow = slow_power(residuals, level, edges)
        self.colour = colour(residuals, edges)
        self.excess, self._judged = None, len(residuals)
        self.against, self.alike = "", _beyond(self.slow, self.colour)
        if not self.alike:
            if few and cost is not None and len(residuals) > 1:
                self.excess = cost(repeats=False).excess
            return
        lasts, limit = lasting(residuals)
        repeats = lasts > REPEATS * limit and not besides and cost is not None
        of_all = besides is residuals  # which are alike
        if besides and (of_all or _beyond(slow_power(besides, level), colour(besides))):
            self.against = "residuals that no friction explains are alike from window to window"
        elif abs(lasts) > limit and not repeats:
            self.against = (
                f"residuals half the data apart correlate by {lasts:.2f}, limit {limit:.2f}: the "
                "model lacks something lasting, such as an offset, a sign or a known mass"
            )
        elif cost is not None:
            alike = cost(repeats=repeats)
            self.excess, (found, limit) = alike.excess, alike.halves
            if found > limit:
                self.against = f"two halves of the data disagree: {found:.0f}, limit {limit:.0f}"

    def widened(self, covariance: FloatArray, blocks: int) -> FloatArray:
        """Return the covariance (p, p) of `blocks` blocks, wider by likeness and by what creeps."""
        alike = self.likely(covariance, blocks)
        return alike if self.creep is None else alike + self.creep

    def likely(self, covariance: FloatArray, blocks: int) -> FloatArray:
        """Return the covariance (p, p) of `blocks` blocks, wider by what their likeness costs.

        The blocks that were judged show it; others cost the same each.
        """
        if self.excess is None:
            return covariance
        return widened(covariance, self.excess * (blocks / self._judged))

    def mismatch(self, level: float) -> bool:
        """Return whether residuals are not noise: too large, or against a correct model."""
        return bool(self.in_words(level))

    def in_words(self, level: float) -> str:
        """Return what noise does not explain; empty: nothing."""
        words = f"residuals are {level**0.5:.3g} times the declared noise"
        if self.unexplained < float("inf"):
            words += (
                f" and {self.unexplained:.0%} of the torques: friction or rotors may be missing"
            )
        large = words * self.is_large(level)
        return "; ".join(filter(None, (large, self.against, self.creeping, self.crept)))

    def is_large(self, level: float) -> bool:
        """Return whether residuals are too large for noise and for unmodelled torques."""
        return level > MISMATCH_LEVEL and self.unexplained > UNEXPLAINED

    def leave_out(self) -> None:
        """Count a block that is left out because it does not fit."""
        self._left_out += 1

    def is_scattered(self, since: int, least: int) -> bool:
        """Return whether too many of at least `least` blocks are left out; `since` are used."""
        return since + self._left_out >= least and is_scattered(self._left_out, since)

    def note(self, level: float) -> None:
        """Count one more block, with or without a mismatch at this noise level."""
        self._lasting = self._lasting + 1 if self.mismatch(level) else 0

    def is_doubtful(self, since: int) -> bool:
        """Return whether `since` blocks since the start are too few to trust a suspect model."""
        return self.suspect and since < SUSPECT_BLOCKS

    def successor(self, blocks: int, changes: int) -> Trust:
        """Return the trust after re-opening number `changes`, which came after `blocks` blocks."""
        soon = changes > 1 and blocks < SUSPECT_BLOCKS
        opened = Trust(suspect=self._lasting > LASTING_BLOCKS or soon)
        opened.crept = self.creeping or self.crept or CREPT * (self.creep is not None)
        return opened

    def snapshot(self) -> dict[str, Any]:
        """Return the state as plain values."""
        return kept(self, _STATE)

    def restore(self, values: Values) -> None:
        """Continue from a snapshot."""
        put(self, _STATE, values)
        self.slow = (float(self.slow[0]), float(self.slow[1]))
        self.colour = (float(self.colour[0]), float(self.colour[1]))
        self.excess, self.creep = (
            None if own is None else np.asarray(own, np.float64)
            for own in (self.excess, self.creep)
        )


def is_scattered(left_out: int, used: int) -> bool:
    """Return whether so many blocks do not fit the others that they are not outliers."""
    return left_out > GATED_SHARE * (left_out + used)


def _beyond(*judged: tuple[float, float]) -> bool:
    """Return whether one of these figures is beyond its limit."""
    return any(found > limit for found, limit in judged)
