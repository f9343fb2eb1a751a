"""Worker processes that do not outlive the process that started them."""

from __future__ import annotations

import ctypes
import signal

PR_SET_PDEATHSIG = 1  # prctl(2)


def end_with_driver() -> None:
    """Have the kernel end this worker with its driver; an interrupt is for the driver alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def end_with_interrupt() -> None:
    """Have the kernel end this worker with its driver, and with what interrupts both."""
    end_with_driver()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
