"""Stamped bytes and frames between ports and codecs, and the protocols of ports."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

# of linux/can.h
EFF_FLAG, RTR_FLAG, ERR_FLAG = 0x80000000, 0x40000000, 0x20000000
EFF_MASK, SFF_MASK = 0x1FFFFFFF, 0x7FF
FD_BRS, FD_FDF = 0x01, 0x04
CLASSIC_BYTES, FD_BYTES = 16, 72
_CLASSIC = struct.Struct("<IB3x8s")
_FD = struct.Struct("<IBB2x64s")


@dataclass(frozen=True, slots=True)
class CanFrame:
    """One CAN frame as a port saw it, sent or received.

    `t_ns` is the receive (or send) stamp on the daemon's monotonic clock. `can_id` is the bare
    identifier, without flag bits.
    """

    t_ns: int
    can_id: int
    data: bytes
    is_fd: bool = False
    is_extended: bool = False
    is_remote: bool = False
    is_error: bool = False
    bitrate_switch: bool = False


@dataclass(frozen=True, slots=True)
class ByteChunk:
    """Bytes of a serial line; `t_ns` is when the last of them was read."""

    t_ns: int
    data: bytes


class Reject(StrEnum):
    """Why wire bytes were not turned into a sample; each has its own counter."""

    SYNC = "sync"  # no sync byte/ID here, bytes skipped while resynchronising
    LENGTH = "length"  # wrong frame length
    CRC = "crc"  # check value failed
    SEQUENCE = "sequence"  # duplicate, or counter out of its window
    RANGE = "range"  # decoded value physically impossible for the device
    STATUS = "status"  # the device itself says the value is not usable
    NODE = "node"  # a sensor frame from a node that is not configured
    STALE = "stale"  # no matching SYNC, or one too old


class FramePort(Protocol):
    """Non-blocking CAN port."""

    hands_back: bool  # whether what is written is read again, stamped when it was on the bus

    def read(self) -> list[CanFrame]:
        """Return every frame received since the last call, with its stamp. Raises PortError."""
        ...

    def write(self, can_id: int, data: bytes) -> CanFrame | None:
        """Send a classic frame; the returned frame carries the stamp taken right after sending.

        None: there is no room for it, and it is not sent. Raises PortError.
        """
        ...

    def take_dropped(self) -> int:
        """Return and forget how many received frames were lost for want of room."""
        ...

    def wake_fds(self) -> tuple[int, ...]:
        """Return the descriptors that should wake the loop early (normally none for CAN)."""
        ...

    def close(self) -> None:
        """Release the interface."""
        ...


class BytePort(Protocol):
    """Non-blocking serial port."""

    def read(self) -> list[ByteChunk]:
        """Return what has come since the last call, in order, with stamps. Raises PortError."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes. Raises PortError."""
        ...

    def wake_fds(self) -> tuple[int, ...]:
        """Return the descriptors that should wake the loop early."""
        ...

    def close(self) -> None:
        """Release the line."""
        ...


def pack_frame(frame: CanFrame) -> bytes:
    """Return the Linux structure of a frame, flag bits in `can_id`."""
    can_id = frame.can_id
    can_id |= EFF_FLAG * frame.is_extended | RTR_FLAG * frame.is_remote | ERR_FLAG * frame.is_error
    if frame.is_fd:
        flags = FD_FDF | FD_BRS * frame.bitrate_switch
        return _FD.pack(can_id, len(frame.data), flags, frame.data)
    return _CLASSIC.pack(can_id, len(frame.data), frame.data)


def unpack_frame(t_ns: int, data: bytes) -> CanFrame | None:
    """Return the frame of a Linux structure; None when it is neither of the two.

    The identifier of an error frame is its error classes, of 29 bits.
    """
    if len(data) == CLASSIC_BYTES:
        word, length, payload = _CLASSIC.unpack(data)
        is_fd = brs = False
    elif len(data) == FD_BYTES:
        word, length, flags, payload = _FD.unpack(data)
        is_fd, brs = True, bool(flags & FD_BRS)
    else:
        return None
    if length > len(payload):
        return None
    extended, error = bool(word & EFF_FLAG), bool(word & ERR_FLAG)
    return CanFrame(
        t_ns=t_ns,
        can_id=word & (EFF_MASK if extended or error else SFF_MASK),
        data=payload[:length],
        is_fd=is_fd,
        is_extended=extended,
        is_remote=bool(word & RTR_FLAG),
        is_error=error,
        bitrate_switch=brs,
    )
