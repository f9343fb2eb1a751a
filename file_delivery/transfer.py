"""Progress and outcome of a transfer."""

from dataclasses import dataclass
from enum import Enum

from spacepackets.cfdp import ConditionCode

Key = tuple[int, int]  # sending entity, transaction number


class TransferState(Enum):
    """State of a transfer."""

    WAITING = "WAITING"
    SENDING = "SENDING"
    RECEIVING = "RECEIVING"
    SUSPENDED = "SUSPENDED"


@dataclass(frozen=True, slots=True)
class Transfer:
    """A transfer that has not ended."""

    key: Key
    name: str
    size: int  # [B]; 0: not known yet
    done: int  # [B]
    state: TransferState
    last_ns: int  # time of the newest unit from the other end, or of new data sent


@dataclass(slots=True)
class TransferOutcome:
    """The end of a transfer."""

    condition: ConditionCode
    text: str  # name of the file, and the reason of a failure
    answer: bytes | None = None  # answers late units of a refused transfer

    @property
    def is_good(self) -> bool:
        """Whether the file arrived complete."""
        return bool(self.condition == ConditionCode.NO_ERROR)
