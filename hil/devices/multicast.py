"""python-can's bus `udp_multicast`, for many frames at a time.

The datagrams are python-can's msgpack maps, and python-can's bus makes the socket. One sendmmsg
sends several frames; the bytes around the data are packed in advance. A kernel filter discards
frames that no node accepts, above all the frames of the nodes themselves.
"""

import ctypes
import os
import socket
import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import can
import msgpack
from can.interfaces.udp_multicast.utils import pack_message

from hil.devices.can_segment import TimedFrame
from hil.devices.datagrams import Datagrams
from hil.devices.dialects import EXTENDED
from hil.devices.heard import HeardFrame, is_heard
from hil.devices.plant_file import BusLink

SO_ATTACH_FILTER = 26
SLOT_BYTES = 512
DATA_KEY = b"\xa4data\xc4"  # followed by a byte of length
UDP_HEADER = 8
ID_TAIL = UDP_HEADER + 31  # `n_id` of the key arbitration_id, then its value
LOAD_WORD, LOAD_HALF, LOAD_BYTE, RETURN = 0x20, 0x28, 0x30, 0x06
JUMP_EQUAL, JUMP_ABOVE, JUMP_FROM = 0x15, 0x25, 0x35
UNHEARD = 0x180, 0x600  # nodes accept no identifier between these two
FILTER = (  # code, jump if true, jump if false, operand; short datagrams are discarded
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


@lru_cache(maxsize=256)
def _around(can_id: int, length: int, is_fd: bool) -> tuple[bytes, bytes]:
    """Return the bytes before and after the data in a datagram of python-can."""
    message = can.Message(
        arbitration_id=can_id & ~EXTENDED,
        data=bytes(length),
        is_extended_id=bool(can_id & EXTENDED),
        is_fd=is_fd,
        bitrate_switch=is_fd,
    )
    packed = pack_message(message)
    start = packed.index(DATA_KEY) + len(DATA_KEY) + 1
    return packed[:start], packed[start + length :]


def datagram(can_id: int, data: bytes, *, is_fd: bool) -> bytes:
    """Return the datagram that python-can's bus sends for a frame."""
    before, after = _around(can_id, len(data), is_fd)
    return before + data + after


class MulticastPort:
    """One bus over UDP multicast."""

    def __init__(self, link: BusLink) -> None:
        given: dict[str, Any] = {} if link.port is None else {"port": link.port}
        self._bus = can.Bus(interface=link.interface, channel=link.channel, fd=link.fd, **given)
        self._socket = socket.socket(fileno=os.dup(self._bus.fileno()))
        self._is_fd = link.fd
        self.receive_errors = 0
        filtered(self._socket, FILTER)
        self._in = Datagrams(self._socket, SLOT_BYTES, reads=True)
        self._out = Datagrams(self._socket, SLOT_BYTES, address_of(self._socket, link.channel))

    def fileno(self) -> int:
        """Return the descriptor that is readable when frames wait."""
        return self._socket.fileno()

    def receive(self) -> list[HeardFrame]:
        """Return the received frames that nodes accept."""
        frames = []
        for stamp_ns, data in self._in.receive():
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
                frames.append((stamp_ns, can_id, payload))
        return frames

    def send(self, frames: Sequence[TimedFrame]) -> int:
        """Send frames; return how many were not sent."""
        datagrams = [
            datagram(can_id, data, is_fd=is_fd)
            for _, can_id, data, is_fd in frames
            if self._is_fd or not is_fd
        ]
        return len(frames) - len(datagrams) + self._out.send(datagrams)

    def close(self) -> None:
        """Release the bus."""
        self._socket.close()
        self._bus.shutdown()


def filtered(end: socket.socket, program: Sequence[tuple[int, int, int, int]]) -> None:
    """Have the kernel discard datagrams for which a classic BPF program returns 0."""
    code = b"".join(struct.pack("=HBBI", *instruction) for instruction in program)
    kept = ctypes.create_string_buffer(code)
    header = struct.pack("@HP", len(program), ctypes.addressof(kept))
    end.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, header)


def address_of(end: socket.socket, group: str) -> bytes:
    """Return the group's struct sockaddr_in or sockaddr_in6."""
    port = end.getsockname()[1]
    found = socket.getaddrinfo(group, port, family=end.family, type=socket.SOCK_DGRAM)
    head = struct.pack("=H", end.family) + struct.pack("!H", port)
    host = socket.inet_pton(end.family, str(found[0][4][0]))
    if end.family == socket.AF_INET6:
        return head + bytes(4) + host + bytes(4)
    return head + host + bytes(8)
