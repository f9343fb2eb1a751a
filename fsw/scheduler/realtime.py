"""Real-time settings of a process; a setting that the system refuses is reported."""

import ctypes
import gc
import os
import sys

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_PR_SET_TIMERSLACK = 29
LATENCY_DEVICE = "/dev/cpu_dma_latency"


def prepare(
    cpu: int | None, priority: int, keys: tuple[str, str] = ("cpu", "realtime_priority")
) -> list[str]:
    """Set timer slack, memory locking, processor and priority; return what was refused.

    Parameters
    ----------
    cpu : the only processor to run on; None: any
    priority : SCHED_FIFO priority; 0: ordinary scheduling
    keys : keys of processor and priority in the section `scheduler`, for messages
    """
    refused = []
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        refused.append(f"memory is not locked: {os.strerror(ctypes.get_errno())}")
    if cpu is not None:
        try:
            os.sched_setaffinity(0, {cpu})
        except OSError as error:
            refused.append(f"scheduler.{keys[0]} {cpu}: {error.strerror}")
    if priority > 0:
        try:
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(priority))
        except OSError as error:
            refused.append(f"scheduler.{keys[1]} {priority}: {error.strerror}")
    return refused


def keep_awake(latency_us: int) -> int:
    """Keep processors out of sleep states that need longer than `latency_us` [us] to wake.

    Returns
    -------
    A descriptor: the kernel obeys the limit (PM QoS) until the descriptor is closed.

    Raises
    ------
    OSError when this is not permitted, or the kernel has no such interface.
    """
    fd = os.open(LATENCY_DEVICE, os.O_WRONLY | os.O_CLOEXEC)
    try:
        os.write(fd, latency_us.to_bytes(4, sys.byteorder))
    except OSError:
        os.close(fd)
        raise
    return fd


def freeze_garbage() -> None:
    """Stop automatic garbage collection and exempt every object made so far from collection."""
    gc.disable()
    gc.freeze()


def collect_young() -> None:
    """Collect garbage of the two young generations; frozen objects are not examined."""
    gc.collect(1)
