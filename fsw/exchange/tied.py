"""Processes that belong to their parent: they find its modules, and end with it."""

import ctypes
import os
import signal
import sys
from contextlib import suppress

_PR_SET_PDEATHSIG = 1  # prctl(2)


def module_command(module: str) -> list[str]:
    """Return the command line that runs a Python module, which is found where this process looks.

    By itself `-m` looks in the current folder first, where others may have put files of any name.
    """
    looked: set[str] = set()
    with suppress(FileNotFoundError):  # the current folder was removed
        looked = {"", os.getcwd()} & set(sys.path)
    return [sys.executable, *([] if looked else ["-P"]), "-m", module]


def end_with(parent: int) -> None:
    """Make the kernel kill this process when its parent ends; exit now if it has ended."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
