"""Time as a port: the only module of the flight software that reads a clock."""

import ctypes
import select
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

CLOCK_READINGS = 4  # attempts at reading two clocks together
TOGETHER_NS = 5_000  # apart at most, so that no attempt is made again
TIME_ERROR = 5  # of adjtimex(2): not synchronised
UNKNOWN_ERROR_NS = 16_000_000_000  # as the kernel has it when nothing steers its clock


class Clock(Protocol):
    """Monotonic time and the one wait of the loop."""

    def now_ns(self) -> int:
        """Return monotonic time [ns]."""
        ...

    def cpu_time_ns(self) -> int:
        """Return the processor time that the calling thread has used [ns]; 0 in simulated time."""
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

    def cpu_time_ns(self) -> int:
        """Return the processor time that the calling thread has used [ns]."""
        return time.thread_time_ns()

    def process_cpu_s(self) -> float:
        """Return the processor time that all threads of this process have used [s]."""
        return time.process_time()

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
    """Return CLOCK_MONOTONIC minus CLOCK_REALTIME [ns], valid for stamps taken just now."""
    return _read_together()[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class UtcCorrelation:
    """UTC against CLOCK_MONOTONIC, as far as the machine knows it.

    Parameters
    ----------
    uncertainty_ns : largest error: the kernel's own bound, and half of the time between readings
    synchronised : whether the kernel's clock is steered by a source of UTC (NTP, PPS, PTP)
    """

    utc_less_monotonic_ns: int
    uncertainty_ns: int
    synchronised: bool


def utc_correlation() -> UtcCorrelation:
    """Return UTC minus CLOCK_MONOTONIC now, with its largest error."""
    offset_ns, apart_ns = _read_together()
    error_ns, synchronised = _kernel_clock_error()
    return UtcCorrelation(
        utc_less_monotonic_ns=-offset_ns,
        uncertainty_ns=error_ns + (apart_ns + 1) // 2,
        synchronised=synchronised,
    )


def _read_together() -> tuple[int, int]:
    """Return CLOCK_MONOTONIC less CLOCK_REALTIME and the time the two readings took [ns].

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
    return offset_ns, least_ns


class _Timex(ctypes.Structure):
    """The head of `struct timex` of adjtimex(2), and room for the rest."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror_us", ctypes.c_long),
        ("esterror_us", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_long * 32),
    )


def _kernel_clock_error() -> tuple[int, bool]:
    """Return the kernel's bound of the error of CLOCK_REALTIME [ns], and whether it is steered.

    Never synchronised, the kernel's bound is 16 s, the largest it knows: the true error has none.
    """
    timex = _Timex()  # modes 0: nothing is set
    state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(timex))
    if state < 0:
        return UNKNOWN_ERROR_NS, False
    return 1000 * int(timex.maxerror_us), state != TIME_ERROR
