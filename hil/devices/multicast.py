"""python-can's `udp_multicast` bus, read and written many frames at a time.

The datagrams are python-can's own (msgpack maps); its bus makes the socket. Frames go out by one
sendmmsg as bytes packed beforehand around the data, and frames that no node hears, above all those
of the nodes themselves, end in a filter of the kernel.
"""

from __future__ import annotations

import ctypes
import os
import socket
import struct
import time
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import can
import msgpack
from can.interfaces.udp_multicast.utils import pack_message

from hil.devices.can_segment import TimedFrame
from hil.devices.heard import READ_LIMIT, HeardFrame, is_heard
from hil.devices.plant_file import BusLink

SO_ATTACH_FILTER = 26
SLOTS = 32  # datagrams of one system call
SLOT_BYTES = 512
DATA_KEY = b"\xa4data\xc4"  # and a byte of length
UDP_HEADER = 8
ID_TAIL = UDP_HEADER + 31  # `n_id` of the key arbitration_id, then its value
LOAD_WORD, LOAD_HALF, LOAD_BYTE, RETURN = 0x20, 0x28, 0x30, 0x06
JUMP_EQUAL, JUMP_ABOVE, JUMP_FROM = 0x15, 0x25, 0x35
UNHEARD = 0x180, 0x600  # nodes hear nothing above the first and below the second identifier
FILTER = (  # code, jump if true, jump if false, operand; a datagram too short is discarded
    (LOAD_WORD, 0, 0, ID_TAIL),
    (JUMP_EQUAL, 0, 5, int.from_bytes(b"n_id", "big")),
    (LOAD_BYTE, 0, 0, ID_TAIL + 4),
    (JUMP_EQUAL, 0, 3, 0xCD),  # an identifier of 16 bits
    (LOAD_HALF, 0, 0, ID_TAIL + 5),
    (JUMP_FROM, 1, 0, UNHEARD[1]),
    (JUMP_ABOVE, 1, 0, UNHEARD[0]),
    (RETURN, 0, 0, 0xFFFFFFFF),
    (RETURN, 0, 0, 0),
)


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

    _fields_ = (("message", _Message), ("sent", ctypes.c_uint))


@lru_cache(maxsize=256)
def _around(can_id: int, length: int, is_fd: bool) -> tuple[bytes, bytes]:
    """Return what stands before and after the data in a datagram of python-can."""
    message = can.Message(
        arbitration_id=can_id,
        data=bytes(length),
        is_extended_id=False,
        is_fd=is_fd,
        bitrate_switch=is_fd,
    )
    packed = pack_message(message)
    start = packed.index(DATA_KEY) + len(DATA_KEY) + 1
    return packed[:start], packed[start + length :]


def datagram(can_id: int, data: bytes, *, is_fd: bool) -> bytes:
    """Return the datagram python-can's bus sends for a frame."""
    before, after = _around(can_id, len(data), is_fd)
    return before + data + after


class _Batch:
    """Memory of one sendmmsg to one destination."""

    def __init__(self, end: socket.socket, destination: bytes) -> None:
        self._descriptor = end.fileno()
        self._buffer = bytearray(SLOTS * SLOT_BYTES)
        memory = (ctypes.c_char * len(self._buffer)).from_buffer(self._buffer)
        self._name = ctypes.create_string_buffer(destination, len(destination))
        self._vectors = (_IoVector * SLOTS)()
        self._headers = (_Header * SLOTS)()
        for i, (vector, header) in enumerate(zip(self._vectors, self._headers, strict=True)):
            vector.base = ctypes.addressof(memory) + i * SLOT_BYTES
            part = header.message
            part.name, part.name_length = ctypes.addressof(self._name), len(destination)
            part.vectors, part.vector_count = ctypes.addressof(vector), 1
        self._sendmmsg = ctypes.CDLL(None, use_errno=True).sendmmsg

    def send(self, datagrams: Sequence[bytes]) -> int:
        """Send up to SLOTS datagrams; return how many did not go out."""
        for i, data in enumerate(datagrams):
            self._buffer[i * SLOT_BYTES : i * SLOT_BYTES + len(data)] = data
            self._vectors[i].length = len(data)
        sent: int = self._sendmmsg(self._descriptor, self._headers, len(datagrams), 0)
        return len(datagrams) - max(sent, 0)


class MulticastPort:
    """One bus over UDP multicast."""

    def __init__(self, link: BusLink) -> None:
        given: dict[str, Any] = {} if link.port is None else {"port": link.port}
        self._bus = can.Bus(interface=link.interface, channel=link.channel, fd=link.fd, **given)
        self._socket = socket.socket(fileno=os.dup(self._bus.fileno()))
        self._is_fd = link.fd
        self.receive_errors = 0
        program = b"".join(struct.pack("=HBBI", *instruction) for instruction in FILTER)
        kept = ctypes.create_string_buffer(program)
        header = struct.pack("@HP", len(FILTER), ctypes.addressof(kept))
        self._socket.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, header)
        self._batch = _Batch(self._socket, _address(self._socket, link.channel))

    def fileno(self) -> int:
        """Return the descriptor that becomes readable with frames."""
        return self._socket.fileno()

    def receive(self) -> list[HeardFrame]:
        """Return the frames that have come and that nodes hear."""
        frames = []
        for _ in range(READ_LIMIT):
            try:
                data, control, _, _ = self._socket.recvmsg(4096, 64, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            try:
                message = msgpack.unpackb(data)
                kinds = ("is_extended_id", "is_error_frame", "is_remote_frame")
                other = any(message[kind] for kind in kinds)
                other |= message["is_fd"] and not self._is_fd
                can_id, payload = int(message["arbitration_id"]), bytes(message["data"])
            except (ValueError, KeyError, TypeError):
                self.receive_errors += 1
                continue
            if not other and is_heard(can_id):
                frames.append((_stamp_ns(control), can_id, payload))
        return frames

    def send(self, frames: Sequence[TimedFrame]) -> int:
        """Send frames; return how many did not go out."""
        datagrams = [
            datagram(can_id, data, is_fd=is_fd)
            for _, can_id, data, is_fd in frames
            if self._is_fd or not is_fd
        ]
        failed = len(frames) - len(datagrams)
        batches = (datagrams[i : i + SLOTS] for i in range(0, len(datagrams), SLOTS))
        return failed + sum(self._batch.send(batch) for batch in batches)

    def close(self) -> None:
        """Release the bus."""
        self._socket.close()
        self._bus.shutdown()


def _stamp_ns(control: list[tuple[int, int, bytes]]) -> int:
    """Return the kernel's stamp, CLOCK_REALTIME."""
    for level, _, data in control:
        if level == socket.SOL_SOCKET and len(data) >= 16:
            seconds, nanoseconds = struct.unpack_from("@qq", data)
            return int(seconds * 1_000_000_000 + nanoseconds)
    return time.time_ns()


def _address(end: socket.socket, group: str) -> bytes:
    """Return the group's struct sockaddr_in or sockaddr_in6."""
    port = end.getsockname()[1]
    found = socket.getaddrinfo(group, port, family=end.family, type=socket.SOCK_DGRAM)
    head = struct.pack("=H", end.family) + struct.pack("!H", port)
    host = socket.inet_pton(end.family, str(found[0][4][0]))
    if end.family == socket.AF_INET6:
        return head + bytes(4) + host + bytes(4)
    return head + host + bytes(8)
