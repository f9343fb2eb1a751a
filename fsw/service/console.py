"""Prints events of severity high to standard error: a terminal, or the systemd journal."""

import os
import sys
from queue import Full, Queue
from threading import Thread

from fsw.messages import Event

WAITING = 100  # most lines that wait while a terminal is stopped; further lines are left out


class Console:
    """Prints events in a separate thread, so that a stopped terminal does not delay the service."""

    def __init__(self) -> None:
        self._lines: Queue[str] = Queue(WAITING)
        Thread(target=self._print, daemon=True).start()

    def event(self, event: Event) -> None:
        """Queue an event of severity high for printing; ignore any other."""
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
