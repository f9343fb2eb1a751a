"""Brings files that grow to the disk in bounded time, so that a power cut loses little of them.

A write is with the system, not yet on the disk: the process may die, the machine may not. Waiting
for the disk takes milliseconds to seconds, so it is done in a thread of its own.
"""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

PERIOD_NS = 2_000_000_000


class DiskSync:
    """Brings files to the disk every two seconds.

    A power cut loses what was written since the last time: two seconds, and the time the disk took.

    Parameters
    ----------
    files : returns the files that grow, among them those that may be missing
    failed : called once per failure with the system's words; the next period tries again
    """

    def __init__(self, files: Callable[[], Iterable[Path]], failed: Callable[[str], None]) -> None:
        self._files, self._failed = files, failed
        self._thread = ThreadPoolExecutor(1, "disk-sync")
        self._running: Future[None] | None = None
        self._due_ns = 0
        self._has_failed = False

    def poll(self, now_ns: int) -> None:
        """Begin the next round when it is time and the last one is over; report its failure."""
        if self._running is not None:
            if not self._running.done():
                return
            self._end(self._running)
            self._running = None
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + PERIOD_NS
            self._running = self._thread.submit(sync_files, tuple(self._files()))

    def close(self) -> None:
        """Bring everything to the disk."""
        self._thread.shutdown()
        with suppress(OSError):  # nobody is there any more to read a report
            sync_files(self._files())

    def _end(self, round_: Future[None]) -> None:
        error = round_.exception()
        if error is not None and not self._has_failed:
            self._failed(str(error))
        self._has_failed = error is not None


def sync_files(paths: Iterable[Path]) -> None:
    """Wait until files and their names are on the disk; leave out those that are missing.

    Raises
    ------
    OSError of the first that failed, after the others.
    """
    found = list(paths)
    failure: OSError | None = None
    for path in (*found, *dict.fromkeys(path.parent for path in found)):
        try:
            descriptor = os.open(path, os.O_RDONLY)
        except OSError:
            continue  # missing, or moved in the meantime
        try:
            os.fsync(descriptor)
        except OSError as error:
            failure = failure or OSError(error.errno, error.strerror, str(path))
        finally:
            os.close(descriptor)
    if failure is not None:
        raise failure
