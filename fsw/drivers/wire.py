"""Stamped bytes and frames between ports and codecs, and the protocols of ports."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol


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
