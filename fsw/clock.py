"""Time as a port: the only module of the flight software that reads a clock."""

from __future__ import annotations

import select
import time
from collections.abc import Sequence
from typing import Protocol

CLOCK_READINGS = 4  # attempts at reading two clocks together
TOGETHER_NS = 5_000  # apart at most, so that no attempt is made again
KERNEL_WAIT_NS = 20_000_000  # of a stamped frame in the kernel's own queues, at most; 16 ms seen


class Clock(Protocol):
    """Monotonic time and the one wait of the loop."""

    def now_ns(self) -> int:
        """Return monotonic time [ns]."""
        ...

    def sleep_until_ns(self, deadline_ns: int, wake_fds: Sequence[int] = ()) -> bool:
        """Sleep until the deadline, or until a descriptor is readable.

        Returns
        -------
        True when the deadline has come, False when a descriptor woke the caller early. Waking on
        serial descriptors is what gives a datagram an arrival stamp much finer than the tick.
        """
        ...


class MonotonicClock:
    """The machine's CLOCK_MONOTONIC."""

    def now_ns(self) -> int:
        """Return CLOCK_MONOTONIC [ns]."""
        return time.monotonic_ns()

    def sleep_until_ns(self, deadline_ns: int, wake_fds: Sequence[int] = ()) -> bool:
        """Sleep with one ppoll (descriptors) or one absolute nanosleep."""
        remaining_ns = deadline_ns - time.monotonic_ns()
        if remaining_ns <= 0:
            return True
        if not wake_fds:
            time.sleep(remaining_ns * 1e-9)
            return True
        readable, _, _ = select.select(wake_fds, (), (), remaining_ns * 1e-9)
        return not readable


def monotonic_less_realtime_ns() -> int:
    """Return what takes a CLOCK_REALTIME stamp of just now to CLOCK_MONOTONIC [ns].

    The clocks are read again, a few times, when something came between the readings.
    """
    least_ns, offset_ns = 1 << 62, 0
    for _ in range(CLOCK_READINGS):
        before_ns = time.monotonic_ns()
        realtime_ns = time.time_ns()
        after_ns = time.monotonic_ns()
        if after_ns - before_ns < least_ns:
            least_ns, offset_ns = after_ns - before_ns, (before_ns + after_ns) // 2 - realtime_ns
        if least_ns < TOGETHER_NS:
            break
    return offset_ns
