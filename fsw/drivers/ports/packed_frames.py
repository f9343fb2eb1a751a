"""Frames in python-can's msgpack form, as its udp_multicast interface sends them.

Datagrams of one sender and one size differ in time, identifier and data only. The first of a size
is unpacked by msgpack and shows where these stand; all others that are equal elsewhere are read as
columns of bytes, any other is unpacked by msgpack too.
"""

import struct
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

PACKED_BYTES = 512  # the packed form of a CAN FD frame takes about 250
MOST_LAYOUTS = 64  # sizes known; what is beyond is unpacked by msgpack
_UINT16, _BIN8, _FLOAT64 = 0xCD, 0xC4, 0xCB  # leading bytes of msgpack values


@lru_cache(maxsize=1024)
def packed(can_id: int, data: bytes) -> bytes:
    """Return a classic frame in its packed form."""
    message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
    return bytes(pack_message(message))


class _Layout(NamedTuple):
    """Byte offsets of the values of base-format data frames of one size."""

    first: NDArray[np.uint8]  # (size,) the datagram that it was found in
    fixed: NDArray[np.uint8]  # (size,) 255 where the bytes do not change, else 0
    can_id: int
    at_id: int | None  # place of the identifier's two bytes; None: it does not change
    data: slice
    flags: int


class Unpacker:
    """Reads packed frames; the layouts seen are kept."""

    def __init__(self) -> None:
        self._layouts: dict[int, _Layout] = {}  # by size

    def frames(self, batch: Received, times_ns: NDArray[np.int64]) -> FrameArray:
        """Return the frames of datagrams, in order; what is no frame is left out.

        Parameters
        ----------
        times_ns : (k,) stamp of each datagram
        """
        frames = np.zeros(len(times_ns), FRAME)
        left = np.ones(len(times_ns), np.bool_)  # not read yet
        for size in set(batch.lengths.tolist()):
            rows = np.flatnonzero(batch.lengths == size)
            layout = self._layout(size, batch.data[rows[0], :size])
            if layout is None:
                continue
            data = batch.data[:, :size][rows]
            alike = ~((data ^ layout.first) & layout.fixed).any(axis=1)
            words: NDArray[Any] = np.full(len(rows), layout.can_id)
            if layout.at_id is not None:
                words = data[:, layout.at_id].astype(np.int64) << 8 | data[:, layout.at_id + 1]
                alike &= words <= SFF_MASK
            if np.count_nonzero(alike) < len(rows):
                rows, data, words = rows[alike], data[alike], words[alike]
            length = layout.data.stop - layout.data.start
            frames["word"][rows], frames["length"][rows] = words, length
            frames["flags"][rows] = layout.flags
            frames["data"][rows, :length] = data[:, layout.data]
            left[rows] = False
        frames["t_ns"] = times_ns
        good = np.ones(len(frames), np.bool_)
        for k in np.flatnonzero(left).tolist():
            row = _unpacked(batch.data[k, : batch.lengths[k]].tobytes(), int(times_ns[k]))
            if row is None:
                good[k] = False
            else:
                frames[k] = rows_of(row)[0]
        return frames if good.all() else frames[good]

    def _layout(self, size: int, datagram: NDArray[np.uint8]) -> _Layout | None:
        layout = self._layouts.get(size)
        if layout is None and len(self._layouts) < MOST_LAYOUTS:
            layout = _layout_of(datagram)
            if layout is not None:
                self._layouts[size] = layout
        return layout


def _layout_of(datagram: NDArray[np.uint8]) -> _Layout | None:
    """Return the layout of a datagram; None where it is no plain frame in python-can's own form."""
    raw = datagram.tobytes()
    try:
        values = msgpack.unpackb(raw)
        if _unpacked(raw, 0) is None or msgpack.packb(values) != raw:
            return None
    except (ValueError, TypeError, msgpack.UnpackException):
        return None
    if values["is_extended_id"] or values["is_remote_frame"] or values["is_error_frame"]:
        return None
    at, places = 1, {}  # behind the byte that begins a map
    for key, value in values.items():
        at += len(msgpack.packb(key))
        places[key] = at
        at += len(msgpack.packb(value))
    word, data, time = places["arbitration_id"], places["data"], places.get("timestamp", 0)
    length = len(values["data"])
    if len(values) > 15 or raw[data] != _BIN8 or raw[time] != _FLOAT64:
        return None
    at_id = word + 1 if raw[word] == _UINT16 else None
    fixed = np.full(len(raw), 255, np.uint8)
    fixed[time + 1 : time + 9] = 0
    fixed[data + 2 : data + 2 + length] = 0
    if at_id is not None:
        fixed[at_id : at_id + 2] = 0
    flags = flags_of(is_fd=values["is_fd"], bitrate_switch=values["bitrate_switch"])
    return _Layout(
        datagram.copy(),
        fixed,
        values["arbitration_id"],
        at_id,
        slice(data + 2, data + 2 + length),
        flags,
    )


def _unpacked(raw: bytes, t_ns: int) -> bytes | None:
    """Return the row of one datagram's frame; None when it is no frame."""
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
