"""Events that somebody must act on, as lines of standard error: a terminal's, or the journal's."""

import os
import sys
from queue import Full, Queue
from threading import Thread

from fsw.messages import Event

WAITING = 100  # lines that a terminal at rest may keep waiting; more are left out


class Console:
    """Prints events of severity high in a thread of its own: a stopped terminal delays nothing."""

    def __init__(self) -> None:
        self._lines: Queue[str] = Queue(WAITING)
        Thread(target=self._print, daemon=True).start()

    def event(self, event: Event) -> None:
        """Print an event, if somebody must act on it."""
        if event.severity != "high":
            return
        try:
            self._lines.put_nowait(f"fsw: {event.code}: {event.text}\n")
        except Full:
            return

    def _print(self) -> None:
        while True:
            line = self._lines.get()
            try:
                os.write(sys.stderr.fileno(), line.encode())
            except (OSError, ValueError):  # the terminal is gone
                return
