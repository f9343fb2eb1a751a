"""Messages between the processes, the Sink protocol, and sinks that discard, copy or join."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from fsw.drivers.wire import ByteChunk, FrameArray
from fsw.messages import Block, Estimate, Event, Snapshot
from fsw.messages.commands import Command, Reply
from fsw.messages.findings import Stall

Record = Mapping[str, Any]  # plain JSON values only
JOINTS = "joints"  # all joints of all buses, if their samples come decoded
IMU, STAR_TRACKER = "imu", "star_tracker"


@dataclass(frozen=True, slots=True, eq=False)
class CanTraffic:
    """Frames of a bus, sent and received, in the order in which the sources accepted them."""

    bus: str
    frames: FrameArray


@dataclass(frozen=True, slots=True)
class SerialTraffic:
    """Raw bytes of a serial device."""

    device: str
    chunks: Sequence[ByteChunk]


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchEnd:
    """End of a batch: all data received by a time were passed on; statistics of the loop."""

    now_ns: int
    lost: tuple[str, ...] = ()  # inputs that have no port
    tick: int = 0
    slips: int = 0  # since the start
    stalls: tuple[Stall, ...] = ()
    over_budget_ns: int = 0  # longest work of a tick that exceeded the budget; 0: none did


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
    """The newest sample of every channel, packed (`fsw.estimation.science`)."""

    t_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class AppliedCommand:
    """One applied command, with the values that a replay needs to apply it again."""

    t_ns: int
    record: Record


@dataclass(frozen=True, slots=True)
class StateRestored:
    """The sequence number of the checkpoint from which this run continues."""

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
        """Accept one message; a sink ignores the types that it does not use."""
        ...

    def close(self) -> None:
        """Release all resources: no message follows."""
        ...


class NullSink:
    """Discards everything; the base of sinks that have nothing to close."""

    def put(self, message: Message) -> None:
        """Discard the message."""

    def close(self) -> None:
        """Do nothing."""


class Fanout:
    """Passes every message to several sinks, in order."""

    def __init__(self, *sinks: Sink) -> None:
        self._sinks = sinks

    def put(self, message: Message) -> None:
        """Pass the message to every sink."""
        for sink in self._sinks:
            sink.put(message)

    def close(self) -> None:
        """Close every sink."""
        for sink in self._sinks:
            sink.close()


class JoinedStatus:
    """Passes messages on and joins the status of the loop with that of the estimation."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._estimation: Record | None = None

    def put(self, message: Message) -> None:
        """Pass a message on; keep the estimation's status until the loop's status comes."""
        if isinstance(message, EstimationStatus):
            self._estimation = message.values
        elif not isinstance(message, StatusReport):
            self._sink.put(message)
        elif self._estimation is not None:
            self._sink.put(StatusReport(message.t_ns, {**message.values, **self._estimation}))

    def close(self) -> None:
        """Close the next sink."""
        self._sink.close()
