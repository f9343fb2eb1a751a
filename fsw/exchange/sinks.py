"""Where the loop hands what it has: the Sink protocol, the null sink and the fan-out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from fsw.drivers.wire import ByteChunk, CanFrame
from fsw.messages import Block, Estimate, Event, Snapshot
from fsw.messages.commands import Reply

Record = Mapping[str, Any]  # plain JSON values only


class Sink(Protocol):
    """Takes everything the loop produces; never blocks and never raises in flight."""

    def can(self, bus: str, frames: Sequence[CanFrame]) -> None:
        """Take frames of a bus, sent and received, in the order the sources saw them."""
        ...

    def serial(self, device: str, chunks: Sequence[ByteChunk]) -> None:
        """Take raw bytes of a serial device."""
        ...

    def block(self, block: Block) -> None:
        """Take one conditioned window."""
        ...

    def estimate(self, estimate: Estimate) -> None:
        """Take one published estimate."""
        ...

    def event(self, event: Event) -> None:
        """Take one event."""
        ...

    def status(self, t_ns: int, status: Record) -> None:
        """Take the health and counter summary."""
        ...

    def science(self, t_ns: int, record: bytes) -> None:
        """Take the newest sample of every channel, packed (`fsw.loop.science`)."""
        ...

    def command(self, t_ns: int, record: Record) -> None:
        """Take one applied command, with what a replay needs to apply it again."""
        ...

    def reply(self, reply: Reply) -> None:
        """Take the answer to a command."""
        ...

    def checkpoint(self, snapshot: Snapshot) -> None:
        """Take the estimator's state to be kept over a restart."""
        ...

    def restored(self, sequence: int) -> None:
        """Take the number of the checkpoint this run continues from."""
        ...

    def close(self) -> None:
        """Nothing more will come."""
        ...


class NullSink:
    """Drops everything; the base of sinks that want only part of it."""

    def can(self, bus: str, frames: Sequence[CanFrame]) -> None:
        """Drop."""

    def serial(self, device: str, chunks: Sequence[ByteChunk]) -> None:
        """Drop."""

    def block(self, block: Block) -> None:
        """Drop."""

    def estimate(self, estimate: Estimate) -> None:
        """Drop."""

    def event(self, event: Event) -> None:
        """Drop."""

    def status(self, t_ns: int, status: Record) -> None:
        """Drop."""

    def science(self, t_ns: int, record: bytes) -> None:
        """Drop."""

    def command(self, t_ns: int, record: Record) -> None:
        """Drop."""

    def reply(self, reply: Reply) -> None:
        """Drop."""

    def checkpoint(self, snapshot: Snapshot) -> None:
        """Drop."""

    def restored(self, sequence: int) -> None:
        """Drop."""

    def close(self) -> None:
        """Nothing to release."""


class Fanout:
    """Hands everything to several sinks, in order."""

    def __init__(self, *sinks: Sink) -> None:
        self._sinks = sinks

    def can(self, bus: str, frames: Sequence[CanFrame]) -> None:
        """Pass on."""
        for sink in self._sinks:
            sink.can(bus, frames)

    def serial(self, device: str, chunks: Sequence[ByteChunk]) -> None:
        """Pass on."""
        for sink in self._sinks:
            sink.serial(device, chunks)

    def block(self, block: Block) -> None:
        """Pass on."""
        for sink in self._sinks:
            sink.block(block)

    def estimate(self, estimate: Estimate) -> None:
        """Pass on."""
        for sink in self._sinks:
            sink.estimate(estimate)

    def event(self, event: Event) -> None:
        """Pass on."""
        for sink in self._sinks:
            sink.event(event)

    def status(self, t_ns: int, status: Record) -> None:
        """Pass on."""
        for sink in self._sinks:
            sink.status(t_ns, status)

    def science(self, t_ns: int, record: bytes) -> None:
        """Pass on."""
        for sink in self._sinks:
            sink.science(t_ns, record)

    def command(self, t_ns: int, record: Record) -> None:
        """Pass on."""
        for sink in self._sinks:
            sink.command(t_ns, record)

    def reply(self, reply: Reply) -> None:
        """Pass on."""
        for sink in self._sinks:
            sink.reply(reply)

    def checkpoint(self, snapshot: Snapshot) -> None:
        """Pass on."""
        for sink in self._sinks:
            sink.checkpoint(snapshot)

    def restored(self, sequence: int) -> None:
        """Pass on."""
        for sink in self._sinks:
            sink.restored(sequence)

    def close(self) -> None:
        """Close all."""
        for sink in self._sinks:
            sink.close()
