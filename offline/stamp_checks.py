"""Checks of the stamps of a recording, in file order: clocks that were set, and missing data."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fsw.exchange.recording import pieces_of
from fsw.messages import IntArray

HOLE_S = 1.0  # a longer time without a message is a hole, for every rate in use
BACK_S = 1e-3  # smaller steps back arise when a recorder writes simultaneous messages


class _Steps:
    """The shortest and the longest step between the stamps of a topic, and where they begin."""

    def __init__(self) -> None:
        self.first_ns: int | None = None
        self._last_ns = np.empty(0, np.int64)
        self.shortest = self.longest = (0, 0)  # step and its beginning [ns]
        self._any = False

    def add(self, t_ns: IntArray) -> None:
        """Continue with further stamps (k,) [ns]."""
        if self.first_ns is None:
            self.first_ns = int(t_ns[0])
        stamps = np.concatenate([self._last_ns, t_ns])
        self._last_ns = stamps[-1:]
        steps = np.diff(stamps)
        if not len(steps):
            return
        low, high = int(np.argmin(steps)), int(np.argmax(steps))
        if not self._any or steps[low] < self.shortest[0]:
            self.shortest = int(steps[low]), int(stamps[low])
        if not self._any or steps[high] > self.longest[0]:
            self.longest = int(steps[high]), int(stamps[high])
        self._any = True


def stamp_findings(parts: Sequence[Path], topics: Sequence[str]) -> list[str]:
    """Return at most two lines, on clocks set back and on holes; times are from the start [s].

    Raises
    ------
    ConfigError when a file cannot be read.
    """
    pieces = sorted((p for p, _ in pieces_of(parts, topics)), key=lambda p: (p.part, p.offset))
    steps = {topic: _Steps() for topic in topics}
    for piece in pieces:
        for topic, column in piece.read().items():
            steps[topic].add(column.spans[:, 0])
    start_ns = min((own.first_ns for own in steps.values() if own.first_ns is not None), default=0)
    back, holes = dict[str, str](), dict[str, str]()
    for topic, own in steps.items():
        (shortest_s, back_s), (longest_s, hole_s) = (
            (step_ns * 1e-9, (at_ns - start_ns) * 1e-9)
            for step_ns, at_ns in (own.shortest, own.longest)
        )
        if shortest_s < -BACK_S:
            back[topic] = f"stamps go back by {-shortest_s:.3g} s at {back_s:.1f} s"
        elif longest_s > HOLE_S:
            holes[topic] = f"nothing for {longest_s:.3g} s at {hole_s:.1f} s"
    set_back, missing = "the clock was set", "data are missing or the clock was set"
    return [*_line(back, set_back), *_line(holes, missing)]


def _line(found: dict[str, str], why: str) -> list[str]:
    """Return one line that names all channels and describes the first; none if `found` is empty."""
    advice = "use one side of it, --from or --to"
    return [f"{', '.join(found)}: {next(iter(found.values()))}: {why}; {advice}"] if found else []
