"""Processes that end with the process that started them, however that one ends.

The kernel kills them (`PR_SET_PDEATHSIG`, prctl(2)) when the thread that started them is gone.
Whatever starts further processes ties those itself: the signal reaches children, not grandchildren.
"""

import ctypes
import multiprocessing
import os
import shutil
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path

PR_SET_PDEATHSIG = 1  # prctl(2)
RUN_UNLESS_ORPHANED = 'test "$PPID" -eq "$0" && exec "$@"'  # the parent may be gone by now


def tied(argv: Sequence[str], env: Mapping[str, str] | None = None) -> list[str]:
    """Return the command line that runs a command as long as this process lives, and no longer.

    Parameters
    ----------
    argv : the command and its arguments
    env : the environment it will be given, this process's if None; its PATH is searched

    Raises
    ------
    FileNotFoundError when there is no such program.
    """
    path = (os.environ if env is None else env).get("PATH")
    for name in (argv[0], "setpriv"):
        if shutil.which(name, path=path) is None:
            raise FileNotFoundError(2, os.strerror(2), name)
    shell = ["sh", "-c", RUN_UNLESS_ORPHANED, str(os.getpid())]
    return ["setpriv", "--pdeathsig", "KILL", "--", *shell, *argv]


def end_with(parent: int) -> None:
    """Have the kernel kill this process when the parent has ended; end now if it has already."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def end_with_driver() -> None:
    """Tie a pool's worker to the process of the pool; an interrupt is for that process alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    driver = multiprocessing.parent_process()
    if driver is not None and driver.pid is not None:
        end_with(driver.pid)


def resident_bytes(pid: int | str = "self") -> int:
    """Return the memory a process has; 0 of one that has ended."""
    try:
        text = Path(f"/proc/{pid}/statm").read_text(encoding="ascii")
    except (FileNotFoundError, ProcessLookupError):
        return 0
    return int(text.split()[1]) * os.sysconf("SC_PAGE_SIZE")
