"""Linux SocketCAN at the level of its system calls: batches of frames with kernel stamps.

Source: the kernel's networking/can.rst, recvmmsg(2), socket(7).
"""

from __future__ import annotations

import ctypes
import errno
import os
import socket
import struct
from typing import NamedTuple

BATCH = 64  # frames per system call
CLASSIC_BYTES, FD_BYTES = 16, 72  # struct can_frame, struct canfd_frame
CONTROL_BYTES = 64  # room for a stamp and a drop counter
SO_RCVBUFFORCE, SO_TIMESTAMPNS, SO_RXQ_OVFL = 33, 35, 40
_CMSG = struct.Struct("=Qii")  # length, level, type
_TIMESPEC = struct.Struct("=qq")
_COUNT = struct.Struct("=I")
_FRAME = struct.Struct("=IB3x8s")
_U32 = 1 << 32


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


class Received(NamedTuple):
    """One frame as the kernel holds it; `realtime_ns` is CLOCK_REALTIME, 0: not stamped."""

    data: bytes
    realtime_ns: int


def prepare(link: socket.socket, buffer_bytes: int) -> int:
    """Ask for a large receive buffer, kernel stamps and the drop counter.

    Returns
    -------
    The buffer's size as the kernel counts it [bytes]: less than twice the wish without the right to
    exceed net.core.rmem_max.
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
    """Drains one socket with recvmmsg, never blocking."""

    def __init__(self, link: socket.socket) -> None:
        self._fd = link.fileno()
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._data = bytearray(BATCH * FD_BYTES)
        self._control = bytearray(BATCH * CONTROL_BYTES)
        data = ctypes.addressof(ctypes.c_char.from_buffer(self._data))
        control = ctypes.addressof(ctypes.c_char.from_buffer(self._control))
        self._vectors = (_Vector * BATCH)()
        self._messages = (_Message * BATCH)()
        for i, (vector, message) in enumerate(zip(self._vectors, self._messages, strict=True)):
            vector.base, vector.length = data + i * FD_BYTES, FD_BYTES
            message.header.vectors = ctypes.pointer(vector)
            message.header.vector_count = 1
            message.header.control = control + i * CONTROL_BYTES
        self._view = memoryview(self._data)
        self._used = BATCH  # messages whose buffer for ancillary data needs its length set again
        self._drops = 0  # the kernel's counter, as last reported
        self.dropped = 0  # frames the receive buffer had no room for

    def receive(self) -> list[Received]:
        """Return up to BATCH waiting frames; fewer than BATCH: no more are waiting.

        The kernel tells of dropped frames with the first frame that found room after them.

        Raises
        ------
        OSError when the interface is down or gone.
        """
        messages = self._messages
        for i in range(self._used):
            messages[i].header.control_length = CONTROL_BYTES
        self._used = 0
        count = self._libc.recvmmsg(self._fd, messages, BATCH, socket.MSG_DONTWAIT, None)
        if count < 0:
            code = ctypes.get_errno()
            if code in (errno.EAGAIN, errno.EINTR):
                return []
            raise OSError(code, os.strerror(code))
        self._used = count
        out = []
        for i in range(count):
            start = i * FD_BYTES
            data = bytes(self._view[start : start + messages[i].length])
            out.append(Received(data, self._ancillary(i, messages[i].header.control_length)))
        return out

    def _ancillary(self, i: int, length: int) -> int:
        """Return a frame's stamp, and read the drop counter if it comes with it."""
        at = i * CONTROL_BYTES
        end = at + length
        stamp_ns = 0
        while at + _CMSG.size <= end:
            size, level, kind = _CMSG.unpack_from(self._control, at)
            if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS:
                seconds, rest_ns = _TIMESPEC.unpack_from(self._control, at + _CMSG.size)
                stamp_ns = seconds * 1_000_000_000 + rest_ns
            elif level == socket.SOL_SOCKET and kind == SO_RXQ_OVFL:
                (drops,) = _COUNT.unpack_from(self._control, at + _CMSG.size)
                self.dropped += (drops - self._drops) % _U32
                self._drops = drops
            at += (size + 7) & ~7
        return stamp_ns
