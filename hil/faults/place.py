"""Where one fault of a script goes: a virtual bench, a window of time, a seed."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from hil.devices.can_segment import TimedFrame
from hil.faults import taps as faults
from hil.faults.taps import ByteAction, FrameAction, Struck, chain
from hil.links.virtual import VirtualBench, VirtualSerial
from hil.world.scenario import FaultEntry

NODE = 0x13


@dataclass(slots=True)
class Place:
    """Where one fault goes."""

    entry: FaultEntry
    world: VirtualBench
    seed: int
    reference: bool
    start_ns: int
    struck: list[Struck[Any]] = field(default_factory=list)
    returned_ns: int = 0  # when the device is itself again

    def __post_init__(self) -> None:
        """By default at the end of the window."""
        self.returned_ns = self.window_ns[1]

    @property
    def began_ns(self) -> int:
        """When the fault first did something."""
        struck = [s.first_ns for s in self.struck if s.first_ns is not None]
        return min(struck, default=self.window_ns[0])

    @property
    def window_ns(self) -> tuple[int, int]:
        """From and to on the bench's clock."""
        first = self.start_ns + round(self.entry.at_s * 1e9)
        return first, first + round(self.entry.for_s * 1e9)

    def size(self, default: float) -> float:
        """Return how much."""
        return default if self.entry.size is None else self.entry.size

    @property
    def node(self) -> int:
        """The node in question."""
        return self.entry.node_id or NODE

    @property
    def answers(self) -> Callable[[TimedFrame], bool]:
        """Whether a frame is the node's sample."""
        can_id = faults.TPDO1_ID + self.node
        return lambda frame: frame[1] == can_id

    def can(
        self,
        action: FrameAction,
        instead: FrameAction,
        rate: float = 1.0,
        only: Callable[[TimedFrame], bool] | None = None,
        *,
        rest: int = 0,
    ) -> Struck[TimedFrame]:
        """Strike frames on their way to the host."""
        return self.can_within(self.window_ns, action, instead, rate, only, rest=rest)

    def can_within(
        self,
        window_ns: tuple[int, int],
        action: FrameAction,
        instead: FrameAction,
        rate: float = 1.0,
        only: Callable[[TimedFrame], bool] | None = None,
        *,
        rest: int = 0,
    ) -> Struck[TimedFrame]:
        """Strike frames within another window."""
        struck = Struck(
            instead if self.reference else action,
            self.entry.rate or rate,
            self.seed,
            only=only or self.answers,
            window_ns=window_ns,
            rest=rest,
        )
        self.world.can.tap = chain(self.world.can.tap, struck)
        self.struck.append(struck)
        return struck

    def serial(self, device: str) -> VirtualSerial:
        """Return the line of the device."""
        return self.world.serials[self.entry.device or device]

    def line(
        self,
        device: str,
        action: ByteAction,
        instead: ByteAction,
        rate: float = 1.0,
        *,
        until_ns: int | None = None,
        rest: int = 0,
    ) -> None:
        """Strike transmissions of a serial device."""
        first, last = self.window_ns
        struck = Struck(
            instead if self.reference else action,
            self.entry.rate or rate,
            self.seed,
            window_ns=(first, until_ns or last),
            rest=rest,
        )
        port = self.serial(device)
        port.tap = chain(port.tap, struck)
        self.struck.append(struck)


Type = Callable[[Place], None]
