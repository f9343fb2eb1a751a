"""Records of the rings: messages from the loop to the service, commands and reports back."""

from __future__ import annotations

import pickle
import struct
from dataclasses import replace
from enum import IntEnum
from typing import Any

from fsw.exchange.recording import raw_traffic
from fsw.exchange.ring import RingReader, RingRecord, RingWriter
from fsw.exchange.sinks import (
    CanTraffic,
    Message,
    RawTraffic,
    SerialTraffic,
    StatusReport,
)
from fsw.messages import Block, Snapshot
from fsw.messages.commands import BatchRequest, Command, JobReport

DOWN_BYTES = 8 << 20  # loop to service: some 20 s of everything
UP_BYTES = 1 << 20  # service to loop
_STAMPED = struct.Struct("<qI")  # stamp [ns], length


class Kind(IntEnum):
    """The type of a ring record."""

    TRAFFIC = 2  # bytes of a link as they are recorded
    MESSAGE = 3  # any other message, pickled
    JOB_SUBMIT = 10
    JOB_ABORT = 11
    END = 12
    COMMAND = 20  # service to loop
    JOB_REPORT = 21


def pack_traffic(traffic: RawTraffic) -> bytes:
    """Return traffic as bytes: topic, encoding, then stamp, length and bytes of every record."""
    parts = []
    for name in (traffic.topic.encode(), traffic.encoding.encode()):
        parts += [bytes((len(name),)), name]
    for t_ns, data in traffic.records:
        parts += [_STAMPED.pack(t_ns, len(data)), data]
    return b"".join(parts)


def unpack_traffic(payload: bytes) -> RawTraffic:
    """Return the traffic that `pack_traffic` packed."""
    middle = 1 + payload[0]
    offset = middle + 1 + payload[middle]
    records = []
    names = payload[1:middle].decode(), payload[middle + 1 : offset].decode()
    while offset < len(payload):
        t_ns, length = _STAMPED.unpack_from(payload, offset)
        offset += _STAMPED.size
        records.append((t_ns, payload[offset : offset + length]))
        offset += length
    return RawTraffic(*names, records)


class RingSink:
    """The loop's sink in flight: every message goes into the ring; lost ones are counted there."""

    def __init__(self, ring: RingWriter) -> None:
        self._ring = ring

    def put(self, message: Message) -> None:
        """Pass a message; a snapshot goes without its blocks, since the service has seen them."""
        if isinstance(message, CanTraffic | SerialTraffic):
            self._ring.push(Kind.TRAFFIC, pack_traffic(raw_traffic(message)))
            return
        if isinstance(message, Snapshot):
            message = replace(message, blocks=())
        elif isinstance(message, StatusReport):
            ring = {"records": self._ring.records, "dropped": self._ring.dropped}
            message = StatusReport(message.t_ns, {**message.values, "ring": ring})
        self._ring.push(Kind.MESSAGE, pickle.dumps(message, protocol=5))

    def close(self) -> None:
        """Say that no message follows."""
        self._ring.push(Kind.END, b"")


def message_of(record: RingRecord) -> Message | None:
    """Return the loop's message of a record; None for a record of another kind."""
    if record.kind == Kind.TRAFFIC:
        return unpack_traffic(record.payload)
    if record.kind == Kind.MESSAGE:
        message: Message = pickle.loads(record.payload)
        return message
    return None


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
