"""Measure how late the wake-ups of the executive and of cyclictest are."""

import contextlib
import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fsw.clock import MonotonicClock
from fsw.scheduler import realtime
from fsw.scheduler.executive import Executive

RATE_HZ = 500.0
MOST_US = 100_000  # largest lateness in cyclictest's histogram


@dataclass(frozen=True, slots=True)
class Lateness:
    """Lateness of the wake-ups of one round [us]: median, 99th percentile, maximum."""

    p50_us: float
    p99_us: float
    max_us: float
    is_fifo: bool


def executive(rate_hz: float, seconds: float, priority: int) -> Lateness:
    """Return the lateness of the executive's ticks without tasks.

    As cyclictest does, the function keeps the processors awake, if the system permits this.
    """
    awake_fd = None
    with contextlib.suppress(OSError):
        awake_fd = realtime.keep_awake(0)
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    refused = realtime.prepare(None, priority)
    is_fifo = bool(priority) and not any("realtime_priority" in text for text in refused)
    try:
        loop = Executive(MonotonicClock(), round(1e9 / rate_hz), ())
        ticks = [loop.step() for _ in range(max(2, round(rate_hz * seconds)))]
    finally:
        os.sched_setscheduler(0, *before)
        if awake_fd is not None:
            os.close(awake_fd)
    return _lateness([(tick.now_ns - tick.due_ns) / 1e3 for tick in ticks[1:]], is_fifo)


def cyclictest(rate_hz: float, seconds: float, priority: int) -> Lateness | None:
    """Return the lateness that cyclictest measures; None where it is not installed or refuses."""
    command = cyclictest_command(rate_hz, seconds, priority)
    if command is None:
        return None
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    counts = cyclictest_wakes(done.stdout)
    if done.returncode or not counts:
        return None
    return _lateness(np.repeat(*np.array(counts).T).tolist(), bool(priority))


def cyclictest_command(rate_hz: float, seconds: float, priority: int = 0) -> list[str] | None:
    """Return the command line of cyclictest; None where it is not installed."""
    program = shutil.which("cyclictest")
    if program is None:
        return None
    return [
        program,
        "-q",
        f"--interval={round(1e6 / rate_hz)}",
        f"--loops={max(2, round(rate_hz * seconds))}",
        f"--histogram={MOST_US}",
        *([f"--priority={priority}"] if priority else []),
        "--mlockall",
    ]


def cyclictest_wakes(output: str) -> list[tuple[int, int]]:
    """Return the rows of cyclictest's histogram: lateness [us] and number of wake-ups."""
    rows = re.findall(r"^(\d{6}) (\d+)$", output, re.MULTILINE)
    return [(int(us), int(count)) for us, count in rows if int(count)]


def _lateness(late_us: Sequence[float], is_fifo: bool) -> Lateness:
    p50, p99 = np.percentile(late_us, [50, 99])
    return Lateness(float(p50), float(p99), float(max(late_us)), is_fifo)
