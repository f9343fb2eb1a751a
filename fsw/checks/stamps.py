"""Stamps of a recording as they stand in the file: clocks that were set, and holes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fsw.exchange.recording import pieces_of

HOLE_S = 1.0  # without a message, of a channel that has them at any rate in use
BACK_S = 1e-3  # less is the order in which a recorder wrote what came at once


def stamp_findings(parts: Sequence[Path], topics: Sequence[str]) -> list[str]:
    """Return a line for every channel whose stamps jump; times are from the recording's start.

    Raises
    ------
    ConfigError when a file cannot be read.
    """
    pieces = sorted((p for p, _ in pieces_of(parts, topics)), key=lambda p: (p.part, p.offset))
    times_ns: dict[str, list[int]] = {topic: [] for topic in topics}
    for piece in pieces:
        for topic, column in piece.read().items():
            times_ns[topic] += [t_ns for t_ns, _, _ in column.spans]
    start_ns = min((t[0] for t in times_ns.values() if t), default=0)
    found = [_jump(topic, np.array(t), start_ns) for topic, t in times_ns.items() if len(t) > 1]
    return [line for line in found if line]


def _jump(topic: str, t_ns: np.ndarray, start_ns: int) -> str:
    steps_s = np.diff(t_ns) * 1e-9
    back, ahead = int(np.argmin(steps_s)), int(np.argmax(steps_s))
    if steps_s[back] < -BACK_S:
        at_s = (t_ns[back] - start_ns) * 1e-9
        return (
            f"{topic}: its stamps go back by {-steps_s[back]:.3g} s at {at_s:.1f} s: the clock was "
            "set while it recorded; use one side of the jump, --from or --to"
        )
    if steps_s[ahead] > HOLE_S:
        at_s = (t_ns[ahead] - start_ns) * 1e-9
        return (
            f"{topic}: nothing for {steps_s[ahead]:.3g} s at {at_s:.1f} s: data are missing or the "
            "clock was set; use one side of the hole, --from or --to"
        )
    return ""
