"""Linux sockets at the level of system calls: batches of datagrams or frames with kernel stamps.

Source: the kernel's networking/can.rst, recvmmsg(2), socket(7).
"""

import ctypes
import errno
import os
import socket
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

BATCH = 64  # datagrams per system call
SLOTS = 1024  # a saturated bus of 1 Mbit/s fills them in 0.12 s
CLASSIC_BYTES, FD_BYTES = 16, 72  # struct can_frame, struct canfd_frame
CONTROL_BYTES = 64  # room for a stamp and a drop counter
SO_RCVBUFFORCE, SO_TIMESTAMPNS, SO_RXQ_OVFL = 33, 35, 40
_STAMP_KIND = socket.SOL_SOCKET | SO_TIMESTAMPNS << 32  # level and type in struct cmsghdr
_DROPS_KIND = socket.SOL_SOCKET | SO_RXQ_OVFL << 32
_STAMP_END, _DROPS_END = 32, 52  # bytes of ancillary data up to the end of either
_FRAME = struct.Struct("=IB3x8s")
_U32 = (1 << 32) - 1


class _Vector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _Header(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint32),
        ("vectors", ctypes.POINTER(_Vector)),
        ("vector_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _Message(ctypes.Structure):
    _fields_ = (("header", _Header), ("length", ctypes.c_uint32))


_MESSAGE = np.dtype(
    {
        "names": ["control_length", "length"],
        "formats": ["u8", "u4"],
        "offsets": [_Header.control_length.offset, _Message.length.offset],
        "itemsize": ctypes.sizeof(_Message),
    }
)


class Received(NamedTuple):
    """Received datagrams; the arrays are copies that the caller may change."""

    data: NDArray[np.uint8]  # (k, w), w: longest length, rounded up to a multiple of 8
    lengths: NDArray[np.uint32]  # (k,)
    realtime_ns: NDArray[np.int64]  # (k,) CLOCK_REALTIME, 0: not stamped


NOTHING = Received(np.empty((0, 0), np.uint8), np.empty(0, np.uint32), np.empty(0, np.int64))


def prepare(link: socket.socket, buffer_bytes: int) -> int:
    """Request a large receive buffer, kernel stamps and the drop counter.

    Returns
    -------
    The buffer's size as the kernel counts it [bytes]: twice the request, or less for a process
    without the right to exceed net.core.rmem_max.
    """
    try:
        link.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, buffer_bytes)
    except PermissionError:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
    link.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    link.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
    return link.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)


def pack_classic(can_id: int, data: bytes) -> bytes:
    """Return the struct can_frame of a base-format data frame."""
    return _FRAME.pack(can_id, len(data), data)


class Receiver:
    """Receives datagrams of one socket by recvmmsg, without blocking, into slots for later reading.

    Parameters
    ----------
    slot_bytes : size of a slot; a longer datagram is cut
    """

    def __init__(self, link: socket.socket, slot_bytes: int = FD_BYTES) -> None:
        self._fd = link.fileno()
        self._recvmmsg = ctypes.CDLL(None, use_errno=True).recvmmsg
        self._data = np.zeros((SLOTS, slot_bytes), np.uint8)
        self._control = np.zeros((SLOTS, CONTROL_BYTES // 8), np.int64)
        self._vectors = (_Vector * SLOTS)()
        self._messages = (_Message * SLOTS)()
        for i, (vector, message) in enumerate(zip(self._vectors, self._messages, strict=True)):
            vector.base, vector.length = self._data[i].ctypes.data, slot_bytes
            message.header.vectors = ctypes.pointer(vector)
            message.header.vector_count = 1
            message.header.control = self._control[i].ctypes.data
        fields = np.frombuffer(memoryview(self._messages), _MESSAGE)
        self._lengths, self._control_lengths = fields["length"], fields["control_length"]
        self._control_lengths[:] = CONTROL_BYTES
        self._starts = [ctypes.byref(message) for message in self._messages]
        self._held = 0
        self._drops = 0  # the kernel's counter, as last reported
        self.dropped = 0  # datagrams the receive buffer had no room for

    def drain(self) -> bool:
        """Fill free slots with waiting datagrams; False if all slots are full and more may wait.

        Raises
        ------
        OSError when the interface is down or gone.
        """
        while self._held < SLOTS:
            wanted = min(BATCH, SLOTS - self._held)
            start = self._starts[self._held]
            count = self._recvmmsg(self._fd, start, wanted, socket.MSG_DONTWAIT, None)
            if count < 0:
                code = ctypes.get_errno()
                if code in (errno.EAGAIN, errno.EINTR):
                    return True
                raise OSError(code, os.strerror(code))
            self._held += count
            if count < wanted:
                return True
        return False

    def read(self) -> Received:
        """Return the datagrams in the slots, in order, and free the slots.

        The kernel reports dropped datagrams with the next datagram that found room.
        """
        count, self._held = self._held, 0
        if not count:
            return NOTHING
        stamps_ns = self._ancillary(count)
        self._control_lengths[:count] = CONTROL_BYTES
        lengths = self._lengths[:count].copy()
        width = (int(lengths.max()) + 7) & ~7
        return Received(self._data[:count, :width].copy(), lengths, stamps_ns)

    def _ancillary(self, count: int) -> NDArray[np.int64]:
        """Return the stamps (k,) of a batch [ns], 0: none, and count the reported drops.

        A record of ancillary data holds its length, its level and type, and the value. The stamp's
        record comes before the record of the drop counter.
        """
        control, used = self._control[:count], self._control_lengths[:count]
        stamps_ns = control[:, 2] * 1_000_000_000 + control[:, 3]
        if (used == _STAMP_END).all() and (control[:, 1] == _STAMP_KIND).all():
            return stamps_ns  # nothing was ever dropped
        stamped = (used >= _STAMP_END) & (control[:, 1] == _STAMP_KIND)
        behind = (used >= _DROPS_END) & (control[:, 5] == _DROPS_KIND)
        alone = (used < _STAMP_END) & (used > 0) & (control[:, 1] == _DROPS_KIND)
        if behind.any() or alone.any():
            counted = np.where(behind, control[:, 6], control[:, 2])[behind | alone] & _U32
            self.dropped += (int(counted[-1]) - self._drops) & _U32
            self._drops = int(counted[-1])
        return np.where(stamped, stamps_ns, 0)
