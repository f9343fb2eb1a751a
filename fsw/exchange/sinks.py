"""Messages of the loop and where they go: the Sink protocol, the null sink and the fan-out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from fsw.drivers.wire import ByteChunk, FrameArray
from fsw.messages import Block, Estimate, Event, Snapshot
from fsw.messages.commands import Reply

Record = Mapping[str, Any]  # plain JSON values only


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


@dataclass(frozen=True, slots=True)
class StatusReport:
    """Health and counters at one time."""

    t_ns: int
    values: Record


@dataclass(frozen=True, slots=True)
class ScienceRecord:
    """The newest sample of every channel, packed (`fsw.loop.science`)."""

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
    | Block
    | Estimate
    | Event
    | Snapshot
    | Reply
    | StatusReport
    | ScienceRecord
    | AppliedCommand
    | StateRestored
)


class Sink(Protocol):
    """Accepts every message of the loop; in the daemon it never blocks and never raises."""

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
