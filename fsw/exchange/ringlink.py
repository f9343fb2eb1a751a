"""Converts messages and commands between the processes to records of the rings, and back."""

import os
import pickle
import struct
from dataclasses import replace
from enum import IntEnum
from functools import lru_cache

import numpy as np

from fsw.config import Config
from fsw.drivers.wire import CLASSIC_ROW_BYTES, FRAME, ByteChunk, FrameArray
from fsw.exchange.ring import RingReader, RingRecord, RingWriter
from fsw.exchange.sinks import (
    AppliedCommand,
    BatchEnd,
    CanTraffic,
    EstimationStatus,
    Message,
    ScienceRecord,
    SerialTraffic,
    StateRestored,
    StatusReport,
)
from fsw.messages import Block, Estimate, Event, Snapshot
from fsw.messages.commands import Command, Reply

DOWN_BYTES = 8 << 20  # rings of the loop and of the estimation: some 10 s of all data
UP_BYTES = 1 << 20  # service to loop
TO_ESTIMATION = (CanTraffic, SerialTraffic, BatchEnd, Command, StatusReport)
TO_SERVICE = (
    CanTraffic,
    SerialTraffic,
    Block,
    Estimate,
    Event,
    Snapshot,
    Reply,
    StatusReport,
    EstimationStatus,
    ScienceRecord,
    AppliedCommand,
    StateRestored,
)
COMMANDS_AT_ONCE = 16
_STAMPED = struct.Struct("<qI")  # stamp [ns], length


class Kind(IntEnum):
    """The type of a ring record."""

    FRAMES = 2  # frames of a bus, as they are in memory
    CHUNKS = 4  # chunks of a serial line
    MESSAGE = 3  # any other message, pickled
    END = 12
    COMMAND = 20  # service to loop


def hand_down(config: Config) -> int:
    """Return the descriptor of a memory file with a configuration, for processes to inherit."""
    fd = os.memfd_create("fsw-config")
    with os.fdopen(fd, "wb", closefd=False) as file:
        pickle.dump(config, file)
    return fd


def handed_down(fd: int) -> Config:
    """Return the configuration in a memory file.

    All processes that inherit the descriptor share its file offset, so no process may move it.
    """
    config: Config = pickle.loads(os.pread(fd, os.fstat(fd).st_size, 0))
    return config


@lru_cache(maxsize=1)  # every ring gets the same traffic
def pack_frames(traffic: CanTraffic) -> bytes:
    """Return traffic of a bus as bytes: name of the bus, size of a row, rows as in memory.

    If all frames are classic, the unused bytes for the data of CAN FD are left out.
    """
    name, frames = traffic.bus.encode(), traffic.frames
    size = FRAME.itemsize if frames["flags"].any() else CLASSIC_ROW_BYTES
    rows = frames.view(np.uint8).reshape(len(frames), FRAME.itemsize)[:, :size]
    return bytes((len(name), *name, size)) + rows.tobytes()


def pack_chunks(traffic: SerialTraffic) -> bytes:
    """Return traffic of a line as bytes: name, then stamp, length and bytes of every chunk."""
    name = traffic.device.encode()
    parts = [bytes((len(name),)), name]
    for chunk in traffic.chunks:
        parts += [_STAMPED.pack(chunk.t_ns, len(chunk.data)), chunk.data]
    return b"".join(parts)


def unpack_traffic(record: RingRecord) -> CanTraffic | SerialTraffic:
    """Return the traffic that `pack_frames` or `pack_chunks` packed."""
    payload = record.payload
    offset = 1 + payload[0]
    name = payload[1:offset].decode()
    if record.kind == Kind.FRAMES:
        return CanTraffic(name, _unpack_rows(payload[offset + 1 :], payload[offset]))
    chunks = []
    while offset < len(payload):
        t_ns, length = _STAMPED.unpack_from(payload, offset)
        offset += _STAMPED.size
        chunks.append(ByteChunk(t_ns, payload[offset : offset + length]))
        offset += length
    return SerialTraffic(name, chunks)


def _unpack_rows(data: bytes, size: int) -> FrameArray:
    """Return the frames of rows of which only the first `size` bytes were kept."""
    rows = np.zeros((len(data) // size, FRAME.itemsize), np.uint8)
    rows[:, :size] = np.frombuffer(data, np.uint8).reshape(-1, size)
    frames: FrameArray = rows.view(FRAME)[:, 0]
    return frames


class RingSink:
    """Writes the messages of a process to a ring; lost frames and chunks are counted.

    Parameters
    ----------
    accepted : types of the messages that the reader wants
    wake : event (eventfd) that wakes the reader at the end of a batch; None: the reader polls
    """

    def __init__(
        self, ring: RingWriter, accepted: tuple[type, ...], wake: int | None = None
    ) -> None:
        self._ring, self._accepted, self._wake = ring, accepted, wake
        self.lost = 0  # frames and chunks that found no room

    def put(self, message: Message) -> None:
        """Write a message; a snapshot goes without its blocks, which the service already has."""
        if not isinstance(message, self._accepted):
            return
        if isinstance(message, CanTraffic):
            if not self._ring.push(Kind.FRAMES, pack_frames(message)):
                self.lost += len(message.frames)
            return
        if isinstance(message, SerialTraffic):
            if not self._ring.push(Kind.CHUNKS, pack_chunks(message)):
                self.lost += len(message.chunks)
            return
        if isinstance(message, Snapshot):
            message = replace(message, blocks=())
        elif isinstance(message, StatusReport):
            ring = {"records": self._ring.records, "dropped": self._ring.dropped}
            message = StatusReport(message.t_ns, {**message.values, "ring": ring})
        self._ring.push(Kind.MESSAGE, pickle.dumps(message, protocol=5))
        if isinstance(message, BatchEnd | Command):
            self._raise()

    def close(self) -> None:
        """Write a record that says that no message follows."""
        self._ring.push(Kind.END, b"")
        self._raise()

    def _raise(self) -> None:
        if self._wake is not None:
            os.eventfd_write(self._wake, 1)


def message_of(record: RingRecord) -> Message | None:
    """Return the message of a record; None for a record of another kind."""
    if record.kind in (Kind.FRAMES, Kind.CHUNKS):
        return unpack_traffic(record)
    if record.kind == Kind.MESSAGE:
        message: Message = pickle.loads(record.payload)
        return message
    return None


def commands_of(ring: RingReader) -> list[Command]:
    """Return the commands of the service since the last call, at most COMMANDS_AT_ONCE."""
    return [pickle.loads(record.payload) for record in ring.read(limit=COMMANDS_AT_ONCE)]
