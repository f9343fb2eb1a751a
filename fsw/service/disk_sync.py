"""Syncs growing files to the disk in bounded time, so that a power cut loses little of them.

Written data are in the system's cache at first: they survive the end of the process, but not a
power cut. Syncing takes milliseconds to seconds, so a separate thread does it.
"""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

PERIOD_NS = 2_000_000_000


class DiskSync:
    """Syncs files to the disk every two seconds.

    A power cut loses at most the data of the last two seconds and of the duration of one sync.

    Parameters
    ----------
    files : returns the paths of the growing files; some may be missing
    failed : receives the error text at the first of successive failures; the next period retries
    """

    def __init__(self, files: Callable[[], Iterable[Path]], failed: Callable[[str], None]) -> None:
        self._files, self._failed = files, failed
        self._thread = ThreadPoolExecutor(1, "disk-sync")
        self._running: Future[None] | None = None
        self._due_ns = 0
        self._has_failed = False

    def poll(self, now_ns: int) -> None:
        """Start the next sync if it is due and the last one has ended; report a failed last one."""
        if self._running is not None:
            if not self._running.done():
                return
            self._end(self._running)
            self._running = None
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + PERIOD_NS
            self._running = self._thread.submit(sync_files, tuple(self._files()))

    def close(self) -> None:
        """Wait for the running sync and sync all files once more."""
        self._thread.shutdown()
        with suppress(OSError):  # no process is left to receive a report
            sync_files(self._files())

    def _end(self, round_: Future[None]) -> None:
        error = round_.exception()
        if error is not None and not self._has_failed:
            self._failed(str(error))
        self._has_failed = error is not None


def sync_files(paths: Iterable[Path]) -> None:
    """Sync files and their directories to the disk; skip those that cannot be opened.

    Raises
    ------
    OSError of the first failed sync, after all others have been tried.
    """
    found = list(paths)
    failure: OSError | None = None
    for path in (*found, *dict.fromkeys(path.parent for path in found)):
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
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
