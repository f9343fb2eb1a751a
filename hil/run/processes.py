"""Child processes that end when their parent ends, whatever ends the parent.

The kernel kills a child (`PR_SET_PDEATHSIG`, prctl(2)) when the thread that started it has ended.
It does not kill grandchildren, so a child that starts processes ties them to itself.
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
    """Return a command line that runs a command and is killed when this process ends.

    Parameters
    ----------
    argv : the command and its arguments
    env : the command's environment, whose PATH is searched; None: this process's environment

    Raises
    ------
    FileNotFoundError if PATH has no such program, or no setpriv.
    """
    path = (os.environ if env is None else env).get("PATH")
    for name in (argv[0], "setpriv"):
        if shutil.which(name, path=path) is None:
            raise FileNotFoundError(2, os.strerror(2), name)
    shell = ["sh", "-c", RUN_UNLESS_ORPHANED, str(os.getpid())]
    return ["setpriv", "--pdeathsig", "KILL", "--", *shell, *argv]


def end_with(parent: int) -> None:
    """Have the kernel kill this process when the parent ends; exit now if the parent has ended."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def end_with_driver() -> None:
    """Tie a pool's worker to the pool's process; the worker ignores SIGINT."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    driver = multiprocessing.parent_process()
    if driver is not None and driver.pid is not None:
        end_with(driver.pid)


def resident_bytes(pid: int | str = "self") -> int:
    """Return the resident memory of a process [bytes]; 0 if the process has ended."""
    try:
        text = Path(f"/proc/{pid}/statm").read_text(encoding="ascii")
    except (FileNotFoundError, ProcessLookupError):
        return 0
    return int(text.split()[1]) * os.sysconf("SC_PAGE_SIZE")
