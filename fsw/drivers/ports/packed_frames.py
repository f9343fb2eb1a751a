"""Frames in python-can's msgpack form, as its udp_multicast interface sends them.

Datagrams of one sender and one size differ only in time, identifier and data. Unpacking the first
datagram of a size by msgpack shows the places of these values. Later datagrams that are equal in
all else are read as columns of bytes; the others are unpacked by msgpack too.
"""

import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import can
import msgpack
import numpy as np
from can.interfaces.udp_multicast.utils import pack_message
from numpy.typing import NDArray

from fsw.drivers.ports.linux_can import Received
from fsw.drivers.wire import (
    EFF_FLAG,
    EFF_MASK,
    ERR_FLAG,
    FRAME,
    HEAD_BYTES,
    MAX_DATA_BYTES,
    RTR_FLAG,
    SFF_MASK,
    FrameArray,
    flags_of,
    row_of,
    rows_of,
)

PACKED_BYTES = 512  # the packed form of a CAN FD frame has about 250 bytes
MOST_LAYOUTS = 64  # sizes with a known layout; datagrams of other sizes are unpacked by msgpack
_UINT16, _BIN8, _FLOAT64 = 0xCD, 0xC4, 0xCB  # leading bytes of msgpack values


@lru_cache(maxsize=1024)
def packed(can_id: int, data: bytes) -> bytes:
    """Return a classic frame in python-can's msgpack form."""
    message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
    return bytes(pack_message(message))


class _Layout(NamedTuple):
    """Places of the values in packed base-format data frames of one size."""

    first: NDArray[np.uint64]  # (words,) the datagram that showed the layout, in words of 8 bytes
    fixed: NDArray[np.uint64]  # (words,) mask of the bits that are the same in all datagrams
    fields: np.dtype[np.void]  # `data`, and `word` if the identifier changes
    length: int  # bytes of data in a frame
    plain: FrameArray  # (1,) frame with the values that are the same in all


class Unpacker:
    """Reads packed frames and keeps the layouts found so far."""

    def __init__(self) -> None:
        self._kinds = np.zeros(PACKED_BYTES + 1, np.intp)  # number of a layout by size; 0: unknown
        self._layouts: list[_Layout] = []  # layouts 1 and on
        self._plain: FrameArray = np.zeros(1, FRAME)  # by number of the layout

    def frames(self, batch: Received, times_ns: NDArray[np.int64]) -> FrameArray:
        """Return the frames of datagrams in order; datagrams without a valid frame are left out.

        Parameters
        ----------
        times_ns : (k,) stamp of each datagram, CLOCK_MONOTONIC
        """
        kinds = self._kinds[batch.lengths]
        if not kinds.all():
            self._learn(batch, (kinds == 0).nonzero()[0])
            kinds = self._kinds[batch.lengths]
        frames: FrameArray = self._plain[kinds]
        frames["t_ns"] = times_ns
        words = batch.data.view(np.uint64)
        left: list[int] = []  # rows not read yet
        for kind in set(kinds.tolist()):
            rows = (kinds == kind).nonzero()[0]
            if not kind:
                left += rows.tolist()
                continue
            layout = self._layouts[kind - 1]
            values = words[rows, : len(layout.first)]
            differs = (values ^ layout.first) & layout.fixed
            if differs.any():
                alike = ~differs.any(axis=1)
                left += rows[~alike].tolist()
                rows, values = rows[alike], values[alike]
            columns = values.view(layout.fields)[:, 0]
            if layout.length:
                frames["data"][rows, : layout.length] = columns["data"]
            if "word" in layout.fields.names:
                frames["word"][rows] = columns["word"]
        return _with_left(frames, batch, sorted(left)) if left else frames

    def _learn(self, batch: Received, rows: NDArray[np.intp]) -> None:
        """Find the layouts of sizes that have none yet."""
        for row in rows.tolist():
            size = int(batch.lengths[row])
            if self._kinds[size] or len(self._layouts) == MOST_LAYOUTS:
                continue
            layout = _layout_of(batch.data[row, :size].tobytes())
            if layout is not None:
                self._layouts.append(layout)
                self._kinds[size] = len(self._layouts)
                self._plain = np.concatenate([self._plain, layout.plain])


def _with_left(frames: FrameArray, batch: Received, left: Sequence[int]) -> FrameArray:
    """Read the rows `left` by msgpack; return all frames without the invalid ones."""
    good = np.ones(len(frames), np.bool_)
    for k in left:
        row = _unpacked(batch.data[k, : batch.lengths[k]].tobytes(), int(frames["t_ns"][k]))
        good[k] = row is not None
        if row is not None:
            frames[k] = rows_of(row)[0]
    return frames[good]


def _layout_of(raw: bytes) -> _Layout | None:
    """Return the layout of a datagram; None unless it is a base frame as python-can packs it."""
    row = _unpacked(raw, 0)
    if row is None:
        return None
    values = msgpack.unpackb(raw)
    if msgpack.packb(values) != raw or rows_of(row)["word"][0] > SFF_MASK:
        return None
    at, places = 1, {}  # behind the byte that begins a map
    for key, value in values.items():
        at += len(msgpack.packb(key))
        places[key] = at
        at += len(msgpack.packb(value))
    word, data, time = places["arbitration_id"], places["data"], places.get("timestamp", 0)
    if len(values) > 15 or raw[data] != _BIN8 or raw[time] != _FLOAT64:
        return None
    fixed = bytearray(-(-len(raw) // 8) * 8)
    fixed[: len(raw)] = bytes([255]) * len(raw)
    fixed[time + 1 : time + 9] = bytes(8)
    length = len(values["data"])
    fixed[data + 2 : data + 2 + length] = bytes(length)
    columns = {"data": (f"({length},)u1", data + 2)} if length else {}
    if raw[word] == _UINT16:
        columns["word"] = (">u2", word + 1)
        fixed[word + 1 : word + 3] = (0xFFFF & ~SFF_MASK).to_bytes(2, "big")
    formats, offsets = zip(*columns.values(), strict=True) if columns else ((), ())
    plain = rows_of(row).copy()
    plain["data"] = 0
    return _Layout(
        np.frombuffer(raw.ljust(len(fixed), b"\0"), np.uint64),
        np.frombuffer(fixed, np.uint64),
        np.dtype(
            {"names": [*columns], "formats": formats, "offsets": offsets, "itemsize": len(fixed)}
        ),
        length,
        plain,
    )


def _unpacked(raw: bytes, t_ns: int) -> bytes | None:
    """Return one datagram's frame as bytes of a `FRAME`; None if the frame is invalid."""
    try:
        values: Any = msgpack.unpackb(raw)
        word, most = values["arbitration_id"], SFF_MASK
        if values["is_extended_id"] or values["is_error_frame"]:
            most = EFF_MASK
        flags = flags_of(is_fd=values["is_fd"], bitrate_switch=values["bitrate_switch"])
        payload = values["data"]
        if word > most or len(payload) > (MAX_DATA_BYTES if flags else HEAD_BYTES):
            return None
        if values["is_extended_id"]:
            word |= EFF_FLAG
        if values["is_remote_frame"]:
            word |= RTR_FLAG
        if values["is_error_frame"]:
            word |= ERR_FLAG
        return row_of(t_ns, word, payload, flags)
    except (ValueError, TypeError, KeyError, struct.error, msgpack.UnpackException):
        return None
