"""The turn of a service on a state directory: after the service of a loop that was killed."""

import os
import re
import signal
import sys
from contextlib import suppress
from pathlib import Path

from file_delivery.locks import take_lock

LOCK_NAME = "service.lock"
PATIENCE_S = 2.0  # time after which a line names the process that holds the lock
LONGEST_S = 30.0  # for a service to write its remaining messages; then it hangs
KILLED_S = 5.0  # for the kernel to release the lock of a killed process
LOCKS = Path("/proc/locks")
PROCESSES = Path("/proc")
_FLOCK = re.compile(r"FLOCK +ADVISORY +WRITE +(?P<process>\d+) +\S+:(?P<inode>\d+) ")
_PARENT = re.compile(rb"\0fsw\.service\.process\0(?:.*\0)?--parent\0(\d+)\0", re.DOTALL)


def take_turn(directory: Path, longest_s: float = LONGEST_S) -> int:
    """Wait until no other service works on a state directory; return the lock's descriptor.

    Meanwhile the loop's messages wait in the ring. A service that has lost its loop and still holds
    the lock after `longest_s` hangs, and is killed.

    Raises
    ------
    TimeoutError when another process keeps the lock; OSError when the directory cannot be used.
    """
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / LOCK_NAME
    with suppress(TimeoutError):
        return take_lock(path, min(PATIENCE_S, longest_s))
    holder = _holder(path)
    _say(f"{path} is held by process {holder or 'unknown'}; waiting at most {longest_s:g} s")
    with suppress(TimeoutError):
        return take_lock(path, longest_s)
    holder = _holder(path)
    if holder is not None and _is_orphan(holder):
        _say(f"the service process {holder} of an earlier daemon hangs and is killed")
        with suppress(ProcessLookupError):
            os.kill(holder, signal.SIGKILL)
    return take_lock(path, KILLED_S)


def _say(text: str) -> None:
    sys.stderr.write(f"fsw: {text}\n")
    sys.stderr.flush()


def _holder(path: Path) -> int | None:
    """Return the process that holds the lock of a file; None if the system does not show it."""
    with suppress(OSError):
        inode = path.stat().st_ino
        for match in _FLOCK.finditer(LOCKS.read_text()):
            if int(match["inode"]) == inode and int(match["process"]):
                return int(match["process"])
    return None


def _is_orphan(process: int) -> bool:
    """Return whether a process is a service whose loop has ended."""
    try:
        words = (PROCESSES / str(process) / "cmdline").read_bytes()
        status = (PROCESSES / str(process) / "status").read_text()
    except OSError:
        return False
    match = _PARENT.search(words)
    parent = re.search(r"^PPid:\s*(\d+)$", status, re.MULTILINE)
    return match is not None and parent is not None and int(match[1]) != int(parent[1])
