"""Guards the state directory for the loop, in threads: no file and no terminal holds a tick up."""

import json
import os
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from threading import Event, Thread

from file_delivery.durable import replace_file
from file_delivery.locks import keep_lock
from file_delivery.regular import read_regular
from fsw.errors import WRONG_CONTENT
from fsw.exchange.status import STATUS_NAME
from fsw.loop.processes import LOCK_NAME

PERIOD_S = 1.0
Fault = tuple[str, str]  # code and text of an event
STDERR = 2
OTHERS = 0o007  # permissions of those who are neither owner nor in the group


class StateGuard:
    """Locks the directory again if the lock's file was removed; writes what the service cannot.

    Parameters
    ----------
    descriptor : holds the lock of the directory
    """

    def __init__(self, directory: Path, descriptor: int) -> None:
        self._directory, self._descriptor = directory, descriptor
        self._found: deque[Fault] = deque()
        self._last: Fault | None = None  # of the last look
        self._reported: Fault | None = None
        self._ended = Event()
        Thread(target=self._watch, name="state-guard", daemon=True).start()

    def faults(self) -> list[Fault]:
        """Return code and text of the faults found since the last call."""
        return [self._found.popleft() for _ in range(len(self._found))]

    def say(self, line: str, status: Mapping[str, object]) -> None:
        """Write a line to standard error and values into the status file, without waiting."""
        Thread(target=self._tell, args=(line, status), daemon=True).start()

    def close(self) -> None:
        """End the watch; the lock stays until the process ends."""
        self._ended.set()

    def look(self) -> None:
        """Check once that the lock is that of the file in the directory; if not, lock it again.

        A fault counts if the next check finds it too: somebody may be removing the directory.
        """
        fault: Fault | None = None
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            self._descriptor = keep_lock(self._directory / LOCK_NAME, self._descriptor)
        except TimeoutError:
            fault = "STATE_TAKEN", f"{self._directory}: another daemon has taken it"
        except OSError as error:
            fault = "STATE_REMOVED", f"{self._directory}: {error.strerror or error}"
        if fault is None:
            self._reported = None
        elif fault == self._last != self._reported:
            self._reported = fault
            self._found.append(fault)
        self._last = fault

    def _watch(self) -> None:
        while not self._ended.wait(PERIOD_S):
            self.look()

    def _tell(self, line: str, status: Mapping[str, object]) -> None:
        path = self._directory / STATUS_NAME
        with suppress(OSError, *WRONG_CONTENT):
            known = json.loads(read_regular(path))
            replace_file(path, json.dumps({**known, **status}))
        with suppress(OSError):  # the terminal is gone
            os.write(STDERR, f"fsw: {line}\n".encode())


def close_to_others(directory: Path) -> None:
    """Let only owner and group read what this process writes, and the directory itself."""
    os.umask(os.umask(0o077) | OTHERS | 0o020)
    with suppress(OSError):  # of another owner: the mode is theirs
        directory.chmod(directory.stat().st_mode & 0o7777 & ~OTHERS)
