"""Whether the model fits what has been seen, and how long it must fit after it did not.

A model that does not fit re-opens the estimate, as a change of bodies does. Then a few blocks fit
anything; so the same wrong model would soon be believed again. After a mismatch that had lasted
before the re-opening, or a re-opening soon after another, the new estimate has to fit for longer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fsw.estimators.recursive.change import MISMATCH_LEVEL, colour, slow_power
from fsw.estimators.recursive.snapshot import Values, kept, put
from fsw.messages import FloatArray

LASTING_BLOCKS = 4  # of mismatch before a re-opening; a change of bodies is found sooner
SUSPECT_BLOCKS = 64  # that a model which did not fit has to fit before it is trusted again
_STATE = ("slow", "colour", "suspect", "_lasting")


class Trust:
    """Judge of the residuals of one estimate, and what is left of its predecessor.

    Attributes
    ----------
    slow, colour : slow power of the residuals, their correlation from block to block, and limits
    suspect : whether the model had not fitted when the estimate was re-opened, or the data have
        contradicted the prior of a sensor, a known body or a mounting
    """

    def __init__(self, *, suspect: bool = False) -> None:
        self.slow, self.colour = (1.0, float("inf")), (0.0, 1.0)
        self.suspect, self._lasting = suspect, 0  # blocks since when the model does not fit

    def learn(self, residuals: Sequence[FloatArray], level: float) -> None:
        """Judge the whitened residuals of the stored blocks, for a noise level."""
        self.slow, self.colour = slow_power(residuals, level), colour(residuals)

    def mismatch(self, level: float) -> bool:
        """Return whether residuals are not noise: too large, slow, or alike from block to block."""
        beyond = [found > limit for found, limit in (self.slow, self.colour)]
        return level > MISMATCH_LEVEL or any(beyond)

    def note(self, level: float) -> None:
        """Count one more block."""
        self._lasting = self._lasting + 1 if self.mismatch(level) else 0

    def is_doubtful(self, since: int) -> bool:
        """Return whether so many blocks since the start are too few to trust the model again."""
        return self.suspect and since < SUSPECT_BLOCKS

    def successor(self, blocks: int, changes: int) -> Trust:
        """Return the trust in a model re-opened after so many blocks, for the so-manieth time."""
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
