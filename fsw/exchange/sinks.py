"""Messages between the processes and where they go: the Sink protocol, null sink and fan-out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from fsw.drivers.wire import ByteChunk, FrameArray
from fsw.messages import Block, Estimate, Event, Snapshot
from fsw.messages.commands import Command, Reply
from fsw.messages.findings import Stall

Record = Mapping[str, Any]  # plain JSON values only
JOINTS = "joints"  # of all buses together, where their samples come decoded
IMU, STAR_TRACKER = "imu", "star_tracker"
WHEELS = "wheels"  # all, where their samples come decoded


@dataclass(frozen=True, slots=True, eq=False)
class CanTraffic:
    """Frames of a bus, sent and received, in the order the sources saw them."""

    bus: str
    frames: FrameArray


@dataclass(frozen=True, slots=True)
class SerialTraffic:
    """Raw bytes of a serial device."""

    device: str
    chunks: Sequence[ByteChunk]


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchEnd:
    """All that had come by a time is handed over; what the loop knows of itself since the last."""

    now_ns: int
    lost: tuple[str, ...] = ()  # inputs that have no port
    tick: int = 0
    slips: int = 0  # so far
    stalls: tuple[Stall, ...] = ()
    over_budget_ns: int = 0  # longest work of a tick over the budget; 0: none


@dataclass(frozen=True, slots=True)
class StatusReport:
    """Health and counters at one time."""

    t_ns: int
    values: Record


@dataclass(frozen=True, slots=True)
class EstimationStatus:
    """The estimation's part of the status, joined with the loop's by `JoinedStatus`."""

    values: Record


@dataclass(frozen=True, slots=True)
class ScienceRecord:
    """The newest sample of every channel, packed (`fsw.loop.estimation.science`)."""

    t_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class AppliedCommand:
    """One applied command, with the values that a replay needs to apply it again."""

    t_ns: int
    record: Record


@dataclass(frozen=True, slots=True)
class StateRestored:
    """The number of the checkpoint this run continues from."""

    sequence: int


Message = (
    CanTraffic
    | SerialTraffic
    | BatchEnd
    | Command
    | Block
    | Estimate
    | Event
    | Snapshot
    | Reply
    | StatusReport
    | EstimationStatus
    | ScienceRecord
    | AppliedCommand
    | StateRestored
)


class Sink(Protocol):
    """Accepts every message; in the daemon it never blocks and never raises."""

    def put(self, message: Message) -> None:
        """Accept one message; a sink ignores the types it has no use for."""
        ...

    def close(self) -> None:
        """Release everything: no message follows."""
        ...


class NullSink:
    """Discards everything; the base of sinks that have nothing to close."""

    def put(self, message: Message) -> None:
        """Discard."""

    def close(self) -> None:
        """Nothing to release."""


class Fanout:
    """Hands every message to several sinks, in order."""

    def __init__(self, *sinks: Sink) -> None:
        self._sinks = sinks

    def put(self, message: Message) -> None:
        """Pass the message to every sink."""
        for sink in self._sinks:
            sink.put(message)

    def close(self) -> None:
        """Close all."""
        for sink in self._sinks:
            sink.close()


class JoinedStatus:
    """Passes everything on, the status once it has both parts: the loop's, and the estimation's."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._estimation: Record | None = None

    def put(self, message: Message) -> None:
        """Keep the estimation's part until the loop's comes."""
        if isinstance(message, EstimationStatus):
            self._estimation = message.values
        elif not isinstance(message, StatusReport):
            self._sink.put(message)
        elif self._estimation is not None:
            self._sink.put(StatusReport(message.t_ns, {**message.values, **self._estimation}))

    def close(self) -> None:
        """Close the sink behind."""
        self._sink.close()
