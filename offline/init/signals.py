"""Judge by names, units and motion which signals of a description are positions or torques."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import tau
from typing import Literal, NamedTuple

import numpy as np
import yaml

from fsw.config.signals import LINEAR, UNITS, plain_unit
from fsw.drivers.layout.decoder import Decoder
from fsw.drivers.layout.signals import Message, Signal
from fsw.drivers.wire import FrameArray
from fsw.messages import FloatArray
from offline.checks.wiring import frames_of
from offline.init.columns import (
    CURRENT,
    OTHER,
    PLANNED,
    POSITION,
    SPEED,
    TORQUE,
    words_of,
)

Role = Literal["position", "torque"]
Quantity = Literal["position", "torque", "current"]
NOT_MEASURED = PLANNED | frozenset(
    ("set", "setpoint", "input", "demand", "limit", "limits", "ff", "gain", "bus", "supply")
)
WORDS = {"position": POSITION, "torque": TORQUE, "current": CURRENT}
OTHERS = {
    "position": SPEED | TORQUE | OTHER,
    "torque": SPEED | OTHER,
    "current": SPEED | (OTHER - CURRENT),
}
OWN_UNITS = {
    "position": {*UNITS["position"], *LINEAR["position"], "count", "counts", "degree", "degrees"},
    "torque": {*UNITS["torque"], *LINEAR["torque"], "permille"},
    "current": {"a", "ma"},
    "neither": {*UNITS["speed"], *LINEAR["speed"], *UNITS["time"], "v", "degc", "%"},
}
LEAST_BITS = 12  # shorter signals are states
COUNTS_PER_REV = 65536.0  # a guess


class Unit(NamedTuple):
    """Keys of a signal's unit, and the SI value of the unit."""

    text: str
    factor: float
    is_current: bool = False


@dataclass(frozen=True, slots=True)
class Use:
    """One signal for each joint."""

    messages: Sequence[Message]
    signals: Sequence[Signal]

    def text(self, joint: int) -> str:
        """Return the keys of a joint's signal, without the closing bracket."""
        own = (self.messages[joint].name, self.signals[joint].name)
        message, signal = (yaml.safe_dump([n], default_flow_style=True).strip()[1:-1] for n in own)
        return f"{{message: {message}, signal: {signal}"

    def values(self, joint: int, frames: FrameArray) -> tuple[FloatArray, FloatArray]:
        """Return stamps [s] and values of a joint in a log."""
        own = frames_of(self.messages[joint], frames)
        (column,) = Decoder(self.messages[joint], [self.signals[joint]])(own["data"])
        return own["t_ns"] * 1e-9, np.asarray(column, np.float64)

    def side_by_side(self, frames: FrameArray) -> FloatArray:
        """Return the values of all joints (k, n), as if their frames came together."""
        columns = [self.values(joint, frames)[1] for joint in range(len(self.signals))]
        return np.stack([own[: min(map(len, columns))] for own in columns], axis=1)

    def moving(self, frames: FrameArray) -> int:
        """Return how many joints move in a log."""
        joints = range(len(self.signals)) if len(frames) else ()
        return sum(bool(np.ptp(self.values(k, frames)[1])) for k in joints)


def unit_of(signal: Signal, role: Role, kind: str, rated_torque_nm: float) -> Unit:
    """Return the unit of a joint's signal, guessed where the description does not say it.

    Parameters
    ----------
    kind : kind of the joint: `revolute` or `prismatic`
    rated_torque_nm : guess of the rated torque, for a torque in shares of it
    """
    unit, known = plain_unit(signal.unit), (UNITS if kind == "revolute" else LINEAR)[role]
    is_raw = not unit and signal.scale == 1 and signal.number != "float"
    if unit in known:
        return Unit("", known[unit])
    if role == "torque" and unit in OWN_UNITS["current"]:
        factor = 1e-3 if unit == "ma" else 1.0
        return Unit(f", unit: {signal.unit}, nm_per_a: 1.0", factor, is_current=True)
    if role == "torque" and (is_raw or unit == "permille"):
        words = f", unit: permille, rated_torque_nm: {rated_torque_nm:g}"
        return Unit(words, rated_torque_nm * 1e-3, is_current=True)
    if role == "position" and kind == "revolute" and (is_raw or unit.startswith("count")):
        words = f", unit: counts, counts_per_rev: {COUNTS_PER_REV}"
        return Unit(words, tau / COUNTS_PER_REV)
    usual = next(iter(known))  # rad, m, N m, N
    if unit.startswith("deg") and "deg" in known:
        usual = "deg"
    return Unit(f", unit: {usual}", known[usual])


def chosen_use(uses: Sequence[Use], wanted: Quantity, frames: FrameArray) -> Use | None:
    """Return what looks most like a measured quantity of all joints; None: nothing does.

    In a log it moves; of equal ones the one with the shortest name, then the first, is chosen.
    """
    likeness = [(_likeness(own, wanted), -len(_words(own))) for own in uses]
    best = max(likeness, default=(0, 0))
    if not best[0]:
        return None
    fits = [own for own, found in zip(uses, likeness, strict=True) if found[0] == best[0]]
    return max(fits, key=lambda own: (own.moving(frames), -len(_words(own))))


def _likeness(own: Use, wanted: Quantity) -> int:
    """Return how much name and unit say that a signal is wanted: 0 to 2."""
    signal = own.signals[0]
    unit, words = plain_unit(signal.unit), _words(own)
    planned = NOT_MEASURED & {*words, *words_of(own.messages[0].name)}
    if signal.bits < LEAST_BITS or planned or OTHERS[wanted] & words:
        return 0
    units = {name for name, known in OWN_UNITS.items() if unit in known}
    if units and wanted not in units:
        return 0
    return bool(units) + bool(WORDS[wanted] & words)


def _words(own: Use) -> frozenset[str]:
    return frozenset(words_of(own.signals[0].title or own.signals[0].name))
