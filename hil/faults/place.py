"""The place of one fault of a script: a virtual bench, a time window and a seed."""

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
    """Place of one fault; `reference` applies the action `instead` in place of the fault."""

    entry: FaultEntry
    world: VirtualBench
    seed: int
    reference: bool
    start_ns: int
    struck: list[Struck[Any]] = field(default_factory=list)
    returned_ns: int = 0  # time when the device works again

    def __post_init__(self) -> None:
        """Set `returned_ns` to the end of the window."""
        self.returned_ns = self.window_ns[1]

    @property
    def began_ns(self) -> int:
        """Time of the fault's first effect [ns]."""
        struck = [s.first_ns for s in self.struck if s.first_ns is not None]
        return min(struck, default=self.window_ns[0])

    @property
    def window_ns(self) -> tuple[int, int]:
        """Start and end on the bench's clock [ns]."""
        first = self.start_ns + round(self.entry.at_s * 1e9)
        return first, first + round(self.entry.for_s * 1e9)

    def size(self, default: float) -> float:
        """Return the fault's size, or the default if the entry has none."""
        return default if self.entry.size is None else self.entry.size

    @property
    def node(self) -> int:
        """Identifier of the affected node."""
        return self.entry.node_id or NODE

    @property
    def answers(self) -> Callable[[TimedFrame], bool]:
        """Function that returns whether a frame is the node's TPDO1."""
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
        window_ns: tuple[int, int] | None = None,
    ) -> Struck[TimedFrame]:
        """Apply the action to frames on their way to the host.

        `rate` is the default share; `window_ns` None: the fault's own window.
        """
        struck = Struck(
            instead if self.reference else action,
            self.entry.rate or rate,
            self.seed,
            only=only or self.answers,
            window_ns=window_ns or self.window_ns,
            rest=rest,
        )
        self.world.can.tap = chain(self.world.can.tap, struck)
        self.struck.append(struck)
        return struck

    def serial(self, device: str) -> VirtualSerial:
        """Return the serial line of the entry's device, or of `device` if the entry has none."""
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
        """Apply the action to transmissions of a serial device; `until_ns` None: window end."""
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
