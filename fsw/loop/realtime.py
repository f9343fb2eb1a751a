"""Real-time settings of the loop process, each best effort: what the system refuses is reported."""

from __future__ import annotations

import ctypes
import gc
import os

from fsw.config import SchedulerConfig

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_PR_SET_TIMERSLACK = 29


def prepare(config: SchedulerConfig) -> list[str]:
    """Set timer slack, memory locking, processor and priority; return what was refused."""
    refused = []
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        refused.append(f"memory is not locked: {os.strerror(ctypes.get_errno())}")
    if config.cpu is not None:
        try:
            os.sched_setaffinity(0, {config.cpu})
        except OSError as error:
            refused.append(f"scheduler.cpu {config.cpu}: {error.strerror}")
    if config.realtime_priority > 0:
        try:
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(config.realtime_priority))
        except OSError as error:
            text = f"scheduler.realtime_priority {config.realtime_priority}: {error.strerror}"
            refused.append(text)
    return refused


def freeze_garbage() -> None:
    """Keep the collector away from everything made so far, and from running by itself."""
    gc.disable()
    gc.freeze()


def collect_young() -> None:
    """Collect recent cycles only; what is frozen is never looked at."""
    gc.collect(1)
