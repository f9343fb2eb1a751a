"""Stamped bytes and frames between ports and codecs, and the protocols of ports.

Frames are passed as arrays of `FRAME`: a stamp, then the Linux structure of a CAN FD frame. A
classic frame uses the first 16 bytes of the structure. `CanFrame` holds one frame as plain values.
"""

import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

# from linux/can.h
EFF_FLAG, RTR_FLAG, ERR_FLAG = 0x80000000, 0x40000000, 0x20000000
EFF_MASK, SFF_MASK = 0x1FFFFFFF, 0x7FF
FD_BRS, FD_FDF = 0x01, 0x04
HEAD_BYTES, CLASSIC_BYTES, FD_BYTES = 8, 16, 72
MAX_DATA_BYTES = 64
_ROW = struct.Struct("<qIBB2x64s")
FRAME = np.dtype(
    {
        "names": ["t_ns", "word", "length", "flags", "reserved", "data"],
        "formats": ["<i8", "<u4", "u1", "u1", "<u2", ("u1", (MAX_DATA_BYTES,))],
        "offsets": [0, 8, 12, 13, 14, 16],
        "itemsize": _ROW.size,
    }
)
_WORD = 8  # byte of a row at which the Linux structure begins
CLASSIC_ROW_BYTES = _WORD + CLASSIC_BYTES  # bytes of a row that a classic frame uses
FrameArray = NDArray[np.void]  # (k,) rows of FRAME; `word` is the identifier with its flag bits
NO_FRAMES: FrameArray = np.empty(0, FRAME)


@dataclass(frozen=True, slots=True)
class CanFrame:
    """One CAN frame, sent or received by a port.

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
    """Bytes of a serial line; `t_ns` is the time at which the last byte was read."""

    t_ns: int
    data: bytes


class Reject(StrEnum):
    """Reasons why wire bytes give no sample; every reason has its own counter."""

    SYNC = "sync"  # no frame begins here; bytes were skipped to find the next one
    LENGTH = "length"  # wrong frame length
    CRC = "crc"  # check value failed
    SEQUENCE = "sequence"  # duplicate, or counter out of its window
    RANGE = "range"  # decoded value physically impossible for the device
    STATUS = "status"  # the device itself says the value is not usable
    NODE = "node"  # a frame of a node that is not configured
    STALE = "stale"  # the time of validity is not known (no matching SYNC), or too old


class FramePort(Protocol):
    """Non-blocking CAN port."""

    hands_back: bool  # whether written frames are read back, stamped at their time on the bus

    def drain(self) -> None:
        """Receive every waiting frame and keep it for `take`. Raises PortError."""
        ...

    def take(self) -> Callable[[], FrameArray]:
        """Return a function that gives every frame drained since the last call.

        The function does most of the work, so the caller may call it later.
        """
        ...

    def write(self, can_id: int, data: bytes) -> CanFrame | None:
        """Send a classic frame and return it with the stamp made right after sending.

        Returns None, and sends nothing, when there is no room for it. Raises PortError.
        """
        ...

    def take_dropped(self) -> int:
        """Return how many received frames found no room since the last call."""
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
        """Return the stamped chunks received since the last call, in order. Raises PortError."""
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


def word_of(frame: CanFrame) -> int:
    """Return the identifier of a frame with its flag bits."""
    flags = EFF_FLAG * frame.is_extended | RTR_FLAG * frame.is_remote | ERR_FLAG * frame.is_error
    return frame.can_id | flags


def flags_of(*, is_fd: bool, bitrate_switch: bool) -> int:
    """Return the flags of a frame's Linux structure; a classic frame has none."""
    return FD_FDF | FD_BRS * bool(bitrate_switch) if is_fd else 0


def row_of(t_ns: int, word: int, data: bytes, flags: int = 0) -> bytes:
    """Return one frame as the bytes of a `FRAME`."""
    return _ROW.pack(t_ns, word, len(data), flags, data)


def frame_array(frames: Iterable[CanFrame]) -> FrameArray:
    """Return frames as an array of `FRAME`."""
    rows = []
    for frame in frames:
        flags = flags_of(is_fd=frame.is_fd, bitrate_switch=frame.bitrate_switch)
        rows.append(row_of(frame.t_ns, word_of(frame), frame.data, flags))
    return rows_of(b"".join(rows))


def rows_of(data: bytes | bytearray | memoryview) -> FrameArray:
    """Return the frames of a buffer of whole `FRAME` rows, without copying it."""
    return np.frombuffer(data, FRAME)


def joined(parts: Sequence[FrameArray]) -> FrameArray:
    """Return arrays of frames as one array, in order."""
    if len(parts) == 1:
        return parts[0]
    whole = f"V{FRAME.itemsize}"  # as raw rows: a copy field by field takes ten times as long
    return np.concatenate([part.view(whole) for part in (NO_FRAMES, *parts)]).view(FRAME)


def picked(frames: FrameArray, is_wanted: NDArray[np.bool_]) -> FrameArray:
    """Return the wanted ones of (k,) frames; `take` copies whole rows, which is fast."""
    return frames.take(np.flatnonzero(is_wanted))


def frame_at(frames: FrameArray, row: int) -> CanFrame:
    """Return one frame of an array as plain values."""
    t_ns, word, length, flags, _, data = frames[row].item()
    return CanFrame(
        t_ns=t_ns,
        can_id=word & (EFF_MASK if word & (EFF_FLAG | ERR_FLAG) else SFF_MASK),
        data=bytes(data[:length]),
        is_fd=bool(flags & FD_FDF),
        is_extended=bool(word & EFF_FLAG),
        is_remote=bool(word & RTR_FLAG),
        is_error=bool(word & ERR_FLAG),
        bitrate_switch=bool(flags & FD_BRS),
    )


def recorded_bytes(frames: FrameArray) -> list[bytes]:
    """Return the Linux structure of every frame: 16 bytes if classic, 72 bytes if CAN FD."""
    data, size, head = frames.tobytes(), FRAME.itemsize, _WORD
    ends = np.where(frames["flags"] & FD_FDF, head + FD_BYTES, head + CLASSIC_BYTES).tolist()
    return [data[k * size + head : k * size + end] for k, end in enumerate(ends)]


def recorded_columns(frames: FrameArray) -> NDArray[np.uint8] | None:
    """Return the Linux structures as rows, (k, 16) or (k, 72); None if both lengths occur."""
    is_fd = (frames["flags"] & FD_FDF) > 0
    if is_fd.any() and not is_fd.all():
        return None
    end = _WORD + (FD_BYTES if is_fd.any() else CLASSIC_BYTES)
    return frames.view(np.uint8).reshape(len(frames), FRAME.itemsize)[:, _WORD:end]


def frames_from(
    stamps_ns: NDArray[np.int64], records: NDArray[np.uint8], sizes: NDArray[np.integer]
) -> FrameArray:
    """Return the frames of Linux structures; structures of an invalid length are left out.

    Parameters
    ----------
    stamps_ns : (k,) receive stamps
    records : (k, 16) or (k, 72), the structures, each in the first bytes of its row
    sizes : (k,) bytes of each structure
    """
    frames = np.zeros(len(records), FRAME)
    start, stop = _WORD, _WORD + records.shape[1]
    frames.view(np.uint8).reshape(len(frames), FRAME.itemsize)[:, start:stop] = records
    is_fd = sizes == FD_BYTES
    frames["t_ns"] = stamps_ns
    frames["flags"] = np.where(is_fd, frames["flags"] & FD_BRS | FD_FDF, 0)
    room = np.where(is_fd, MAX_DATA_BYTES, np.where(sizes == CLASSIC_BYTES, HEAD_BYTES, -1))
    good = frames["length"] <= room
    return frames if good.all() else picked(frames, good)


def frame_list(frames: FrameArray) -> list[CanFrame]:
    """Return the frames of an array as plain values."""
    return [frame_at(frames, row) for row in range(len(frames))]


def pack_frame(frame: CanFrame) -> bytes:
    """Return the Linux structure of a frame, with the flag bits in its identifier."""
    return recorded_bytes(frame_array([frame]))[0]


def unpack_frame(t_ns: int, data: bytes) -> CanFrame | None:
    """Return the frame of a Linux structure; None if the structure has an invalid length.

    The `can_id` of an error frame holds its error classes (29 bits).
    """
    if len(data) not in (CLASSIC_BYTES, FD_BYTES):
        return None
    record = np.frombuffer(data, np.uint8)[None]
    found = frames_from(np.array([t_ns]), record, np.array([len(data)]))
    return frame_at(found, 0) if len(found) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class PdoMapping:
    """One transmit PDO as a description has it."""

    number: int  # from 1
    cob_id: int  # with its flag bits
    transmission: int
    inhibit: int = 0  # [100 us]
    event_ms: int = 0
    entries: tuple[int, ...]  # index << 16 | subindex << 8 | bits
