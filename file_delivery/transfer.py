"""Progress and outcome of a transfer."""

from dataclasses import dataclass
from enum import Enum

from spacepackets.cfdp import ConditionCode

Key = tuple[int, int]  # entity that sends, number of the transaction


class TransferState(Enum):
    """Where a transfer stands."""

    WAITING = "WAITING"
    SENDING = "SENDING"
    RECEIVING = "RECEIVING"
    SUSPENDED = "SUSPENDED"


@dataclass(frozen=True, slots=True)
class Transfer:
    """A transfer that is not over."""

    key: Key
    name: str
    size: int  # [B]; 0: not known yet
    done: int  # [B]
    state: TransferState
    last_ns: int  # last unit from the other end, or last new data sent


@dataclass(slots=True)
class TransferOutcome:
    """How a transfer ended."""

    condition: ConditionCode
    text: str  # name of the file, and the reason of a failure
    answer: bytes | None = None  # to what may still come of a transfer that was refused

    @property
    def is_good(self) -> bool:
        """Whether the file arrived whole."""
        return bool(self.condition == ConditionCode.NO_ERROR)
