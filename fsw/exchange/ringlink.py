"""Records of the rings: messages from the loop to the service, and commands back."""

from __future__ import annotations

import pickle
import struct
from dataclasses import replace
from enum import IntEnum

from fsw.exchange.recording import raw_traffic
from fsw.exchange.ring import RingReader, RingRecord, RingWriter
from fsw.exchange.sinks import (
    CanTraffic,
    Message,
    RawTraffic,
    SerialTraffic,
    StatusReport,
)
from fsw.messages import Snapshot
from fsw.messages.commands import Command

DOWN_BYTES = 8 << 20  # loop to service: some 20 s of everything
UP_BYTES = 1 << 20  # service to loop
COMMANDS_AT_ONCE = 16
_STAMPED = struct.Struct("<qI")  # stamp [ns], length


class Kind(IntEnum):
    """The type of a ring record."""

    TRAFFIC = 2  # bytes of a link as they are recorded
    MESSAGE = 3  # any other message, pickled
    END = 12
    COMMAND = 20  # service to loop


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
    """The sink of a loop process: every message goes into the ring; lost ones are counted there."""

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


def commands_of(ring: RingReader) -> list[Command]:
    """Return the commands that the service has passed since the last call."""
    return [pickle.loads(record.payload) for record in ring.read(limit=COMMANDS_AT_ONCE)]
