"""Locks between processes, as files that no other user can open: nobody waits without a bound."""

import errno
import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PERMISSIONS = 0o600
POLL_S = 0.02


def take_lock(path: Path, wait_s: float) -> int:
    """Lock a file, which is made if it is missing; return the descriptor that holds the lock.

    The kernel releases the lock when the process ends, also when it is killed.

    Raises
    ------
    TimeoutError when another process holds the lock for `wait_s` [s]; OSError without the file.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, PERMISSIONS)
    with suppress(OSError):  # made by an earlier version, or of another owner
        os.fchmod(descriptor, PERMISSIONS)
    until_s = time.monotonic() + wait_s
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= until_s:
                os.close(descriptor)
                text = f"another process holds the lock for more than {wait_s:g} s"
                raise TimeoutError(errno.ETIMEDOUT, text, str(path)) from None
            time.sleep(POLL_S)
        except BaseException:
            os.close(descriptor)
            raise
        else:
            return descriptor


def keep_lock(path: Path, descriptor: int) -> int:
    """Return a descriptor that holds the lock of the file which is at the path now.

    If the file was removed, the one that is there now is locked, or a new one, and the old lock is
    released.

    Raises
    ------
    TimeoutError when another process has locked it; OSError without the file.
    """
    with suppress(FileNotFoundError):
        if os.path.samestat(path.stat(), os.fstat(descriptor)):
            return descriptor
    taken = take_lock(path, 0.0)
    os.close(descriptor)
    return taken


@contextmanager
def locked(path: Path, wait_s: float) -> Iterator[None]:
    """Hold the lock of a file. Raises TimeoutError or OSError as `take_lock` does."""
    descriptor = take_lock(path, wait_s)
    try:
        yield
    finally:
        os.close(descriptor)
