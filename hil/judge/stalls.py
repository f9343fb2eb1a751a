"""Events of the daemon that stalls of the bench's process explain.

Unlike a real device, a simulated device answers late if the bench's process gets no processor time.
The bench records these stalls. The daemon's reports of lateness after a stall are not its faults.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from fsw.messages import Event

LATENESS = frozenset(  # events about a device that is late but intact
    {
        "BUS_SILENT",
        "IMU_JITTER",
        "IMU_SILENT",
        "JOINT_LATE",
        "JOINT_SILENT",
        "SYNC_LOST",
        "TRACKER_LATE",
        "TRACKER_SILENT",
    }
)
FOUND_NS = 150_000_000  # after a stall, until data are sent, the batch ends, and it is checked


def bench_stalls(events: Iterable[Event], stalls_ns: Sequence[tuple[int, int]]) -> dict[str, Any]:
    """Return number and length of the bench's stalls, and counts of explained events by code.

    `covered_s` is the total time [s] in which an event counts as explained.

    `stalls_ns` : start and end of each on the daemon's clock
    """
    explains = Counter(
        event.code
        for event in events
        if event.code in LATENESS
        and any(start <= event.t_ns <= end + FOUND_NS for start, end in stalls_ns)
    )
    longest_ns, covered_ns, covered_to_ns = 0, 0, -(1 << 62)
    for start, end in sorted(stalls_ns):
        longest_ns = max(longest_ns, end - start)
        covered_ns += max(0, end + FOUND_NS - max(start, covered_to_ns))
        covered_to_ns = max(covered_to_ns, end + FOUND_NS)
    return {
        "count": len(stalls_ns),
        "longest_s": 1e-9 * longest_ns,
        "covered_s": 1e-9 * covered_ns,
        "explains": dict(explains),
    }
