"""Send or receive many datagrams by one system call, sendmmsg(2) or recvmmsg(2), with stamps."""

import ctypes
import errno
import os
import socket
import struct
import time
from collections.abc import Sequence

SLOTS = 32  # datagrams in one system call
SO_TIMESTAMPNS = 35
CONTROL_BYTES = 64
STAMP = struct.Struct("@NiiqQ")  # struct cmsghdr and struct timespec


class _IoVector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _Message(ctypes.Structure):
    """struct msghdr."""

    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint32),
        ("vectors", ctypes.c_void_p),
        ("vector_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _Header(ctypes.Structure):
    """struct mmsghdr."""

    _fields_ = (("message", _Message), ("length", ctypes.c_uint))


class Datagrams:
    """Buffers for sendmmsg(2) and recvmmsg(2) on one socket.

    Parameters
    ----------
    end : the socket
    slot_bytes : length of the longest datagram; longer ones are truncated
    destination : struct sockaddr of the receiver; empty: the socket's own peer
    """

    def __init__(
        self, end: socket.socket, slot_bytes: int, destination: bytes = b"", *, reads: bool = False
    ) -> None:
        self._descriptor, self._slot_bytes = end.fileno(), slot_bytes
        self._buffer, self._control = (
            bytearray(SLOTS * slot_bytes),
            bytearray(SLOTS * CONTROL_BYTES),
        )
        base, control = (
            ctypes.addressof((ctypes.c_char * len(memory)).from_buffer(memory))
            for memory in (self._buffer, self._control)
        )
        self._name = ctypes.create_string_buffer(destination, len(destination))
        self._vectors = (_IoVector * SLOTS)()
        self._headers = (_Header * SLOTS)()
        for i, (vector, header) in enumerate(zip(self._vectors, self._headers, strict=True)):
            vector.base, vector.length = base + i * slot_bytes, slot_bytes
            part = header.message
            if destination:
                part.name, part.name_length = ctypes.addressof(self._name), len(destination)
            part.vectors, part.vector_count = ctypes.addressof(vector), 1
            part.control = control + i * CONTROL_BYTES
            part.control_length = CONTROL_BYTES if reads else 0
        self._libc = ctypes.CDLL(None, use_errno=True)

    def send(self, datagrams: Sequence[bytes]) -> int:
        """Send datagrams; return how many were not sent."""
        return sum(self._send(datagrams[i : i + SLOTS]) for i in range(0, len(datagrams), SLOTS))

    def _send(self, datagrams: Sequence[bytes]) -> int:
        for i, data in enumerate(datagrams):
            start = i * self._slot_bytes
            self._buffer[start : start + len(data)] = data
            self._vectors[i].length = len(data)
        sent: int = self._libc.sendmmsg(self._descriptor, self._headers, len(datagrams), 0)
        return len(datagrams) - max(sent, 0)

    def receive(self) -> list[tuple[int, bytes]]:
        """Return at most SLOTS waiting datagrams: stamp [ns, CLOCK_REALTIME] and data.

        Raises
        ------
        OSError while the link is down; the socket works again when the link is up.
        """
        count: int = self._libc.recvmmsg(
            self._descriptor, self._headers, SLOTS, socket.MSG_DONTWAIT, None
        )
        if count < 0:
            code = ctypes.get_errno()
            if code in (errno.EAGAIN, errno.EINTR):
                return []
            raise OSError(code, os.strerror(code))
        received = [self._received(i) for i in range(count)]
        for i in range(count):
            self._headers[i].message.control_length = CONTROL_BYTES
        return received

    def _received(self, i: int) -> tuple[int, bytes]:
        header, start = self._headers[i], i * self._slot_bytes
        data = bytes(self._buffer[start : start + header.length])
        stamp_ns = 0
        if header.message.control_length >= STAMP.size:
            _, level, kind, seconds, nanoseconds = STAMP.unpack_from(
                self._control, i * CONTROL_BYTES
            )
            if (level, kind) == (socket.SOL_SOCKET, SO_TIMESTAMPNS):
                stamp_ns = seconds * 1_000_000_000 + nanoseconds
        return stamp_ns or time.time_ns(), data
