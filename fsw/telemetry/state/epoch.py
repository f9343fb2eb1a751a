"""Origin of stored times: mission elapsed time begins again when the machine starts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

MAX_CLOCK_ID_CHARACTERS = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class Epoch:
    """The origin of mission elapsed time.

    Parameters
    ----------
    clock_id : another text after each start of the machine, which restarts the monotonic clock
    utc_less_met_ns : time of day (CLOCK_REALTIME) minus mission elapsed time [ns]
    uncertainty_ns : largest error of `utc_less_met_ns` [ns]; not stored
    synchronised : whether a source of UTC steers the time of day; not stored
    """

    clock_id: str
    utc_less_met_ns: int
    uncertainty_ns: int = 0
    synchronised: bool = False

    def document(self) -> dict[str, object]:
        """Return plain values, to be stored with times."""
        return {"clock_id": self.clock_id, "utc_less_met_ns": self.utc_less_met_ns}

    @classmethod
    def parse(cls, document: Mapping[str, object]) -> Epoch:
        """Return the epoch of plain values. Raises KeyError, TypeError or ValueError."""
        clock_id, offset_ns = document["clock_id"], document["utc_less_met_ns"]
        if not isinstance(clock_id, str) or not isinstance(offset_ns, int):
            raise TypeError("clock_id and utc_less_met_ns: must be text and a whole number")
        return cls(clock_id=clock_id[:MAX_CLOCK_ID_CHARACTERS], utc_less_met_ns=offset_ns)


def carried_over(t_ns: int, then: Epoch, now: Epoch) -> int:
    """Convert a mission elapsed time of the epoch `then` to the epoch `now` [ns].

    Within one start of the machine the number stays the same. Across a start the time of day
    connects the epochs. A time before the machine's start is negative.
    """
    if then.clock_id == now.clock_id:
        return t_ns
    return t_ns + then.utc_less_met_ns - now.utc_less_met_ns
