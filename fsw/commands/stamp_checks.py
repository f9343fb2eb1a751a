"""Checks of the stamps of a recording, in file order: clocks that were set, and missing data."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fsw.exchange.recording import pieces_of

HOLE_S = 1.0  # a longer time without a message is a hole, for every rate in use
BACK_S = 1e-3  # smaller steps back arise when a recorder writes simultaneous messages


def stamp_findings(parts: Sequence[Path], topics: Sequence[str]) -> list[str]:
    """Return at most two lines, on clocks set back and on holes; times are from the start [s].

    Raises
    ------
    ConfigError when a file cannot be read.
    """
    pieces = sorted((p for p, _ in pieces_of(parts, topics)), key=lambda p: (p.part, p.offset))
    times_ns: dict[str, list[int]] = {topic: [] for topic in topics}
    for piece in pieces:
        for topic, column in piece.read().items():
            times_ns[topic] += column.spans[:, 0].tolist()
    start_ns = min((t[0] for t in times_ns.values() if t), default=0)
    back, holes = dict[str, str](), dict[str, str]()
    for topic, values in times_ns.items():
        steps_s = np.diff(values) * 1e-9
        if not len(steps_s):
            continue
        at_s = (np.array(values) - start_ns) * 1e-9
        first, longest = int(np.argmin(steps_s)), int(np.argmax(steps_s))
        if steps_s[first] < -BACK_S:
            back[topic] = f"stamps go back by {-steps_s[first]:.3g} s at {at_s[first]:.1f} s"
        elif steps_s[longest] > HOLE_S:
            holes[topic] = f"nothing for {steps_s[longest]:.3g} s at {at_s[longest]:.1f} s"
    set_back, missing = "the clock was set", "data are missing or the clock was set"
    return [*_line(back, set_back), *_line(holes, missing)]


def _line(found: dict[str, str], why: str) -> list[str]:
    """Return one line that names all channels and describes the first; none if `found` is empty."""
    advice = "use one side of it, --from or --to"
    return [f"{', '.join(found)}: {next(iter(found.values()))}: {why}; {advice}"] if found else []
