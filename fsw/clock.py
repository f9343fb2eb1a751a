"""Clocks: no other module of the flight software reads the time of the system."""

import ctypes
import select
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
CLOCK_READINGS = 4  # most attempts to read two clocks together
TOGETHER_NS = 5_000  # two readings this close need no further attempt
TIME_ERROR = 5  # returned by adjtimex(2): not synchronised
UNKNOWN_ERROR_NS = 16_000_000_000  # the kernel's bound when nothing steers its clock


class Clock(Protocol):
    """Monotonic time, and the only wait of the loop."""

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
        True when the deadline has passed, False when a descriptor was readable before. A wake by a
        serial descriptor gives a datagram an arrival stamp much finer than the tick.
        """
        ...


class MonotonicClock:
    """Clock of this machine: CLOCK_MONOTONIC."""

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
        """Sleep by `time.sleep` for the remaining time, or by `select` if descriptors are given."""
        remaining_ns = deadline_ns - time.monotonic_ns()
        if remaining_ns <= 0:
            return True
        if not wake_fds:
            time.sleep(remaining_ns * 1e-9)
            return True
        readable, _, _ = select.select(wake_fds, (), (), remaining_ns * 1e-9)
        return not readable


def suspended_s() -> int:
    """Return how long the machine has been suspended since it started [s].

    CLOCK_MONOTONIC stands still meanwhile, CLOCK_BOOTTIME does not.
    """
    monotonic_ns = time.monotonic_ns()
    return max(0, time.clock_gettime_ns(time.CLOCK_BOOTTIME) - monotonic_ns) // 10**9


def boot_id() -> str:
    """Return the identifier of the monotonic clock; empty if the system does not provide it.

    It is the kernel's boot identifier. After the machine was suspended, the time suspended is added
    to it: the clock stood still, so a time
    from before gives no age.
    """
    try:
        boot = BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        return ""
    asleep_s = suspended_s()
    return f"{boot} +{asleep_s}" if asleep_s else boot


def monotonic_less_realtime_ns() -> int:
    """Return CLOCK_MONOTONIC minus CLOCK_REALTIME [ns], for stamps made just now."""
    return _read_together()[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class UtcCorrelation:
    """Offset of UTC from CLOCK_MONOTONIC, as the machine knows it.

    Parameters
    ----------
    uncertainty_ns : largest error: the kernel's bound plus half of the time between the readings
    synchronised : whether a source of UTC (NTP, PPS, PTP) steers the kernel's clock
    """

    utc_less_monotonic_ns: int
    uncertainty_ns: int
    synchronised: bool


def utc_correlation() -> UtcCorrelation:
    """Return UTC minus CLOCK_MONOTONIC as it is now, with its largest error."""
    offset_ns, apart_ns = _read_together()
    error_ns, synchronised = _kernel_clock_error()
    return UtcCorrelation(
        utc_less_monotonic_ns=-offset_ns,
        uncertainty_ns=error_ns + (apart_ns + 1) // 2,
        synchronised=synchronised,
    )


def _read_together() -> tuple[int, int]:
    """Return CLOCK_MONOTONIC minus CLOCK_REALTIME and the time that the readings took [ns].

    The clocks are read up to `CLOCK_READINGS` times; the quickest reading is used.
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
    """The first fields of `struct timex` of adjtimex(2), and room for the others."""

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
    """Return the kernel's error bound of CLOCK_REALTIME [ns], and whether UTC steers the clock.

    For a clock that was never synchronised the bound is 16 s; the true error may be larger.
    """
    timex = _Timex()  # modes 0: only read
    state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(timex))
    if state < 0:
        return UNKNOWN_ERROR_NS, False
    return 1000 * int(timex.maxerror_us), state != TIME_ERROR
