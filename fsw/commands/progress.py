"""How far a command has come, on stderr: on a terminal one line that is rewritten."""

from __future__ import annotations

import os
import re
import sys
from types import TracebackType

from fsw.clock import MonotonicClock

QUIET_NS = 10 * 10**9  # between two lines of one stage, where no terminal is
NUMBERS = re.compile(r"[-+]?\d[\d.e+-]*")
CLEAR = "\r\x1b[K"
PLAIN_WIDTH = 80  # of a terminal that does not say
STAYS = "warning: "  # a text that begins so is not rewritten


class Progress:
    """Called with a line of text; leaving its `with` clears the line of a terminal.

    Elsewhere a stage, which is a text but for its numbers, is a line when it begins and every ten
    seconds.
    """

    def __init__(self, command: str) -> None:
        self._command, self._stage = command, ""
        self._said_ns, self._clock = 0, MonotonicClock()

    def __call__(self, text: str) -> None:
        """Say how far the command has come."""
        line = f"fsw: {self._command}: {text}"
        if sys.stderr.isatty() and text.startswith(STAYS):
            self._write(f"{CLEAR}{line}\n")
        elif sys.stderr.isatty():
            width = os.get_terminal_size(sys.stderr.fileno()).columns or PLAIN_WIDTH
            self._write(f"{CLEAR}{line[: max(width - 1, 1)]}")
        else:
            stage, now_ns = NUMBERS.sub("", text), self._clock.now_ns()
            if stage != self._stage or now_ns >= self._said_ns + QUIET_NS:
                self._stage, self._said_ns = stage, now_ns
                self._write(f"{line}\n")

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if sys.stderr.isatty():
            self._write(CLEAR)

    def _write(self, text: str) -> None:
        sys.stderr.write(text)
        sys.stderr.flush()
