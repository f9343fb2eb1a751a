"""Progress of a command on stderr; on a terminal it is one line that is rewritten."""

from __future__ import annotations

import os
import re
import sys
from types import TracebackType

from fsw.clock import MonotonicClock

QUIET_NS = 10 * 10**9  # between two lines of one stage if stderr is not a terminal
NUMBERS = re.compile(r"[-+]?\d[\d.e+-]*")
CLEAR = "\r\x1b[K"
PLAIN_WIDTH = 80  # columns of a terminal that reports no width
STAYS = "warning: "  # a text that begins with this is not rewritten


class Progress:
    """Prints each text it is called with; on a terminal the end of `with` clears the line.

    If stderr is not a terminal, a text is printed when its stage begins and every ten seconds.
    Texts that differ only in their numbers belong to one stage.
    """

    def __init__(self, command: str) -> None:
        self._command, self._stage = command, ""
        self._said_ns, self._clock = 0, MonotonicClock()

    def __call__(self, text: str) -> None:
        """Print `text` as the present progress of the command."""
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
