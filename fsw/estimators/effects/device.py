"""A kind of device besides the joints: what the general code must know of it.

Values of a sample (k, width) are those of the device's section of the configuration.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from fsw.config import Config
from fsw.estimators.model.state_group import StateGroup
from fsw.messages import FloatArray, IntArray, Window
from fsw.messages.findings import Finding

Samples = tuple[IntArray, FloatArray]  # times (k,) [ns], values (k, width)


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """Inputs of the devices along a motion: wrenches that sensors feel, and firings."""

    wrench: Callable[[int, FloatArray], FloatArray]  # (k, 6) of a sensor at times (k,) [s]
    firings: Mapping[str, Sequence[tuple[float, float]]]  # start and duration [s], by device


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """What the devices of one kind add to a block."""

    fields: dict[str, FloatArray] | None  # of `Block`; None: the state of a device is unknown
    findings: list[Finding] = field(default_factory=list)
    removed: int = 0  # outliers left out
    is_smooth: bool = True  # False: a force changes, so the channels are not polynomials
    loses_momentum: bool = False  # from now on it is not known


class Follower(Protocol):
    """Follows the devices of one kind from window to window."""

    def at(self, window: Window, t_ns: IntArray) -> Part:
        """Return the part of the next window's block, with nodes at t_ns (m,)."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """One kind of device; `gentle` and `along` take one entry of its section.

    Attributes
    ----------
    section : the list in the configuration
    gentle : for an entry, times (k,) [s] and a window's length [s]: values (k, width) of a device
        that works gently, for a rehearsal
    groups : its states, next to one another in the table of states
    follow : makes the follower of these devices; None: they are sensors of the arm
    along : for an entry, its place i and the times (k,) [ns] of its reports: noise-free samples in
        the window [start_ns, stop_ns) of a motion
    """

    section: str
    gentle: Callable[[Any, FloatArray, float], FloatArray]
    along: Callable[[Any, int, IntArray, tuple[int, int], Driven], Samples]
    groups: tuple[StateGroup, ...] = ()
    follow: Callable[[Config], Follower] | None = None

    def followers(self, config: Config) -> list[Follower]:
        """Return what follows the devices of a configuration; empty if it has none."""
        return [self.follow(config)] if self.follow and getattr(config, self.section) else []
