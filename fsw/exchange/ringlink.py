"""What crosses the rings: sink calls from the loop to the service, commands and reports back."""

from __future__ import annotations

import pickle
import struct
from collections.abc import Sequence
from dataclasses import replace
from enum import IntEnum
from typing import Any

from fsw.drivers.wire import ByteChunk, CanFrame
from fsw.exchange.recording import pack_frame, unpack_frame
from fsw.exchange.ring import RingReader, RingRecord, RingWriter
from fsw.exchange.sinks import Record, Sink
from fsw.messages import Block, Estimate, Event, Snapshot
from fsw.messages.commands import BatchRequest, Command, JobReport, Reply

DOWN_BYTES = 8 << 20  # loop to service: some 20 s of everything
UP_BYTES = 1 << 20  # service to loop
_TIME = struct.Struct("<q")
_STAMPED = struct.Struct("<qI")  # stamp [ns], length


class Kind(IntEnum):
    """What a ring record is."""

    CAN = 2
    SERIAL = 3
    BLOCK = 4
    ESTIMATE = 5
    EVENT = 6
    STATUS = 7
    COMMAND_APPLIED = 8
    REPLY = 9
    JOB_SUBMIT = 10
    JOB_ABORT = 11
    END = 12
    CHECKPOINT = 13
    RESTORED = 14
    SCIENCE = 15
    COMMAND = 20  # service to loop
    JOB_REPORT = 21


def pack_can(bus: str, frames: Sequence[CanFrame]) -> bytes:
    """Return a batch of frames as bytes."""
    name = bus.encode()
    parts = [bytes((len(name),)), name]
    for frame in frames:
        data = pack_frame(frame)
        parts += (_STAMPED.pack(frame.t_ns, len(data)), data)
    return b"".join(parts)


def pack_serial(device: str, chunks: Sequence[ByteChunk]) -> bytes:
    """Return a batch of chunks as bytes."""
    name = device.encode()
    parts = [bytes((len(name),)), name]
    for chunk in chunks:
        parts += (_STAMPED.pack(chunk.t_ns, len(chunk.data)), chunk.data)
    return b"".join(parts)


def _unpack(payload: bytes) -> tuple[str, list[tuple[int, bytes]]]:
    offset = 1 + payload[0]
    name = payload[1:offset].decode()
    items = []
    while offset < len(payload):
        t_ns, length = _STAMPED.unpack_from(payload, offset)
        offset += _STAMPED.size
        items.append((t_ns, payload[offset : offset + length]))
        offset += length
    return name, items


class RingSink:
    """The loop's sink in flight: everything goes into the ring, what does not fit is counted."""

    def __init__(self, ring: RingWriter) -> None:
        self._ring = ring

    def can(self, bus: str, frames: Sequence[CanFrame]) -> None:
        """Pass frames."""
        self._ring.push(Kind.CAN, pack_can(bus, frames))

    def serial(self, device: str, chunks: Sequence[ByteChunk]) -> None:
        """Pass chunks."""
        self._ring.push(Kind.SERIAL, pack_serial(device, chunks))

    def block(self, block: Block) -> None:
        """Pass a block."""
        self._push(Kind.BLOCK, block)

    def estimate(self, estimate: Estimate) -> None:
        """Pass an estimate."""
        self._push(Kind.ESTIMATE, estimate)

    def event(self, event: Event) -> None:
        """Pass an event."""
        self._push(Kind.EVENT, event)

    def status(self, t_ns: int, status: Record) -> None:
        """Pass a summary, with the ring's own counters."""
        ring = {"records": self._ring.records, "dropped": self._ring.dropped}
        self._push(Kind.STATUS, (t_ns, {**status, "ring": ring}))

    def science(self, t_ns: int, record: bytes) -> None:
        """Pass a record of samples."""
        self._ring.push(Kind.SCIENCE, _TIME.pack(t_ns) + record)

    def command(self, t_ns: int, record: Record) -> None:
        """Pass an applied command."""
        self._push(Kind.COMMAND_APPLIED, (t_ns, dict(record)))

    def reply(self, reply: Reply) -> None:
        """Pass a reply."""
        self._push(Kind.REPLY, reply)

    def checkpoint(self, snapshot: Snapshot) -> None:
        """Pass the state without its blocks: the service has seen them."""
        self._push(Kind.CHECKPOINT, replace(snapshot, blocks=()))

    def restored(self, sequence: int) -> None:
        """Pass the number of the checkpoint."""
        self._push(Kind.RESTORED, sequence)

    def close(self) -> None:
        """Say that nothing more will come."""
        self._push(Kind.END, None)

    def _push(self, kind: Kind, value: object) -> None:
        self._ring.push(kind, pickle.dumps(value, protocol=5))


def deliver(record: RingRecord, sink: Sink) -> None:
    """Make the sink call a record of the loop stands for; records of other kinds are ignored."""
    kind, payload = record
    if kind == Kind.CAN:
        bus, items = _unpack(payload)
        frames = [unpack_frame(t_ns, data) for t_ns, data in items]
        sink.can(bus, [frame for frame in frames if frame is not None])
    elif kind == Kind.SERIAL:
        device, items = _unpack(payload)
        sink.serial(device, [ByteChunk(t_ns, data) for t_ns, data in items])
    elif kind == Kind.BLOCK:
        sink.block(pickle.loads(payload))
    elif kind == Kind.ESTIMATE:
        sink.estimate(pickle.loads(payload))
    elif kind == Kind.EVENT:
        sink.event(pickle.loads(payload))
    elif kind == Kind.STATUS:
        sink.status(*pickle.loads(payload))
    elif kind == Kind.SCIENCE:
        sink.science(_TIME.unpack_from(payload)[0], payload[_TIME.size :])
    elif kind == Kind.COMMAND_APPLIED:
        sink.command(*pickle.loads(payload))
    elif kind == Kind.CHECKPOINT:
        sink.checkpoint(pickle.loads(payload))
    elif kind == Kind.RESTORED:
        sink.restored(pickle.loads(payload))
    elif kind == Kind.REPLY:
        sink.reply(pickle.loads(payload))


def load(record: RingRecord) -> Any:  # noqa: ANN401
    """Return the value of a pickled record."""
    return pickle.loads(record.payload)


class RingJobs:
    """The loop's end of batch jobs and commands: requests go down, reports and commands come up."""

    def __init__(self, down: RingWriter, up: RingReader) -> None:
        self._down, self._up = down, up
        self._reports: list[JobReport] = []
        self._commands: list[Command] = []

    def store(self, block: Block) -> None:
        """Nothing: the service keeps the blocks the sink gets."""

    def submit(self, request: BatchRequest, now_ns: int) -> None:  # noqa: ARG002
        """Ask the service to start a job."""
        self._down.push(Kind.JOB_SUBMIT, pickle.dumps(request, protocol=5))

    def abort(self) -> None:
        """Ask the service to end the job."""
        self._down.push(Kind.JOB_ABORT, b"")

    def poll(self, now_ns: int) -> list[JobReport]:  # noqa: ARG002
        """Return new reports."""
        self._look()
        reports, self._reports = self._reports, []
        return reports

    def commands(self) -> list[Command]:
        """Return new commands."""
        self._look()
        commands, self._commands = self._commands, []
        return commands

    def _look(self) -> None:
        for record in self._up.read(limit=16):
            value = pickle.loads(record.payload)
            if record.kind == Kind.COMMAND:
                self._commands.append(value)
            elif record.kind == Kind.JOB_REPORT:
                self._reports.append(value)
