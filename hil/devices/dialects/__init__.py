"""Dialects of joint drives that do not speak the tailored format.

A dialect is one module of this package: what its frames hold, what makes a drive send, and how the
flight software is configured to read it by description. Its name is the scenario's
`sensors.joints.dialect`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, Literal, NamedTuple, Protocol

Trigger = Literal["timer", "sync", "command"]
EXTENDED = 1 << 31  # of an identifier of 29 bits


class Measured(NamedTuple):
    """What a drive measures, in its own sign and zero."""

    position_rad: float
    speed_rad_s: float
    torque_nm: float
    clock_us: int  # of the drive, at that instant
    counter: int = 0  # of the SYNC that it answers


class Frame(NamedTuple):
    """A frame that is ready some time after the measurement."""

    after_ns: float
    word: int  # identifier with flag EXTENDED
    data: bytes
    is_fd: bool = False


class Drive(Protocol):
    """A device with one or more joints; a number distinguishes devices of one kind."""

    @property
    def trigger(self) -> Trigger:
        """What makes it measure and send: its own timer, SYNC, or a command of another master."""

    @property
    def encode(self) -> Callable[..., Sequence[Frame]]:
        """Makes the frames of a measurement; arguments: its number, and a `Measured` per joint."""

    @property
    def command(self) -> Callable[[int], Frame] | None:
        """Makes the frame by which the other master asks it; for trigger `command`."""

    @property
    def latch_ns(self) -> float:
        """Time from a SYNC, or from the end of a command, to the measurement."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """Protocol of the drives of a bus, which are numbered by `node`.

    Parameters
    ----------
    trigger, encode, command, latch_ns : as of any `Drive`
    messages : description of the frames of a drive, for the flight software
    joint : keys of a drive's joint in the flight configuration: signals and timing
    bus : keys of its bus
    torque_step_nm, position_step_rad : resolution on the wire, which the flight software counts as
        noise; 0: that of a float
    """

    trigger: Trigger
    encode: Callable[[int, Measured], Sequence[Frame]]
    latch_ns: float = 0.0
    command: Callable[[int], Frame] | None = None
    messages: Callable[[int], Sequence[Mapping[str, Any]]]
    joint: Callable[[int], Mapping[str, Any]]
    bus: Mapping[str, Any] = field(default_factory=lambda: {"sync": "none", "listen_only": True})
    torque_step_nm: float = 0.0
    position_step_rad: float = 0.0


def dialect_of(name: str) -> Dialect:
    """Return the dialect of a module of this package.

    Raises
    ------
    ValueError if no module has this name.
    """
    known = [module.name for module in iter_modules(__path__)]
    if name not in known:
        raise ValueError(f"joints.dialect: {name!r} must be one of {', '.join(known)}")
    found: Dialect = import_module(f"{__name__}.{name}").DIALECT
    return found
