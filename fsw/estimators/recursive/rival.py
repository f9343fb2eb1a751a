"""The estimate before a re-opening, which continues next to the new one until the data decide.

An alarm says that the blocks no longer fit. Either the bodies have changed, or it was a false alarm
and the next blocks fit again. Both hypotheses continue over the following blocks. Their logarithmic
likelihood ratio is that of Page's sum, of the old estimate against the smallest change that the sum
is made for, in units of its limit: a block that fits counts for the old estimate, one that does not
fit counts against it. Wald's sequential test decides at +-1. A new alarm decides against the old
estimate, too, and so does a test that does not end.
Source: Wald, Sequential Analysis (1947), 3; the ratio as in Page, Biometrika 41 (1954).
"""

from collections.abc import Mapping
from enum import Enum
from typing import Any

from fsw.errors import NUMERICAL
from fsw.estimators.recursive.recursion import Recursion
from fsw.estimators.recursive.snapshot import Values, kept, put
from fsw.messages import Block

_STATE = ("evidence", "blocks")
MOST_BLOCKS = 64  # after which an undecided test ends against the old estimate


class Standing(Enum):
    """What the blocks since an alarm say about the estimate before it."""

    OPEN = 0
    REFUTED = 1
    CONFIRMED = 2


class Rival:
    """The recursion before an alarm, and the evidence since.

    Attributes
    ----------
    recursion : the estimate before the alarm, with all blocks since that fit it
    evidence : logarithmic likelihood ratio for it, in units of the limit of Page's sum
    blocks : number of blocks since the alarm
    """

    def __init__(self, recursion: Recursion) -> None:
        self.recursion, self.evidence, self.blocks = recursion, 0.0, 0

    def snapshot(self) -> dict[str, Any]:
        """Return the state as plain values; stored blocks are referred to by their index."""
        return kept(self, _STATE) | {"recursion": self.recursion.snapshot()}

    def restore(self, values: Values, blocks: Mapping[int, Block]) -> None:
        """Continue from a snapshot; raise EstimatorError if a block is missing."""
        self.recursion.restore(values["recursion"], blocks)
        put(self, _STATE, values)

    def fold(self, block: Block) -> Standing:
        """Fold in a block and return what the blocks say; arithmetic that fails is a refutation."""
        try:
            changed = self.recursion.fold(block)
        except NUMERICAL:
            return Standing.REFUTED
        self.blocks += 1
        self.evidence -= self.recursion.monitor.step
        lost = changed or not self.recursion.armed  # it is not armed after a restart
        if lost or self.evidence <= -1.0 or self.blocks >= MOST_BLOCKS:
            return Standing.REFUTED
        return Standing.CONFIRMED if self.evidence >= 1.0 else Standing.OPEN
