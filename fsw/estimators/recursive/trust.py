"""Whether the model fits the data so far, and how long it must fit again after it did not.

A model that does not fit re-opens the estimate, as a change of bodies does. Any model fits the
first few blocks, so the same wrong model would soon be trusted again. If the mismatch lasted before
the re-opening, or if the last re-opening was not long ago, the new estimate must fit for longer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fsw.estimators.recursive.change import MISMATCH_LEVEL, colour, slow_power
from fsw.estimators.recursive.snapshot import Values, kept, put
from fsw.messages import FloatArray

LASTING_BLOCKS = 4  # blocks of mismatch before a re-opening; a change of bodies is found sooner
SUSPECT_BLOCKS = 64  # blocks that a model must fit after a mismatch before it is trusted again
_STATE = ("slow", "colour", "suspect", "_lasting")


class Trust:
    """Judgement of one estimate's residuals, and the suspicion that its predecessor left.

    Attributes
    ----------
    slow, colour : the residuals' slow power, and correlation between blocks, each with its limit
    suspect : whether the model had not fitted when the estimate was re-opened, or the data have
        contradicted the prior of a sensor, a known body or a mounting
    """

    def __init__(self, *, suspect: bool = False) -> None:
        self.slow, self.colour = (1.0, float("inf")), (0.0, 1.0)
        self.suspect, self._lasting = suspect, 0  # successive blocks with a mismatch

    def learn(self, residuals: Sequence[FloatArray], level: float) -> None:
        """Judge the stored blocks' whitened residuals; `level`: noise variance over declared."""
        self.slow, self.colour = slow_power(residuals, level), colour(residuals)

    def mismatch(self, level: float) -> bool:
        """Return whether residuals are not noise: too large, slow, or correlated between blocks."""
        beyond = [found > limit for found, limit in (self.slow, self.colour)]
        return level > MISMATCH_LEVEL or any(beyond)

    def note(self, level: float) -> None:
        """Count one more block, with or without a mismatch at this noise level."""
        self._lasting = self._lasting + 1 if self.mismatch(level) else 0

    def is_doubtful(self, since: int) -> bool:
        """Return whether `since` blocks since the start are too few to trust the model again."""
        return self.suspect and since < SUSPECT_BLOCKS

    def successor(self, blocks: int, changes: int) -> Trust:
        """Return the trust after re-opening number `changes`, which came after `blocks` blocks."""
        soon = changes > 1 and blocks < SUSPECT_BLOCKS
        return Trust(suspect=self._lasting > LASTING_BLOCKS or soon)

    def snapshot(self) -> dict[str, Any]:
        """Return the state as plain values."""
        return kept(self, _STATE)

    def restore(self, values: Values) -> None:
        """Continue from a snapshot."""
        put(self, _STATE, values)
        self.slow = (float(self.slow[0]), float(self.slow[1]))
        self.colour = (float(self.colour[0]), float(self.colour[1]))
