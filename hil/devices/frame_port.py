"""A bus whose socket carries struct can_frame: SocketCAN, or UDP datagrams (`udp_frames`).

One system call sends all answers to a SYNC. Source of the layout: the kernel's networking/can.rst.
"""

import os
import socket
import struct
from collections.abc import Sequence
from typing import Any

import can

from hil.devices.can_segment import TimedFrame
from hil.devices.canopen import SYNC_ID
from hil.devices.datagrams import Datagrams
from hil.devices.heard import HEARD, HeardFrame, is_heard
from hil.devices.multicast import address_of, filtered
from hil.devices.plant_file import BusLink

HEAD = struct.Struct("=IBB2x")  # identifier and flags, length, flags of CAN FD
CLASSIC_BYTES, FD_BYTES = 16, 72
SFF_MASK = 0x7FF  # higher bits are flags: extended, remote, error
BIT_RATE_SWITCH, FD_FRAME = 0x01, 0x04
TAP_WAIT_S = 0.005  # for the host's copy of a SYNC that the devices have received
TAP_APART_NS = 50_000_000  # most between two stamps of one SYNC; the counter repeats much later
LOAD_BYTE, RETURN, JUMP_EQUAL, JUMP_FROM, JUMP_ABOVE = 0x30, 0x06, 0x15, 0x35, 0x25
UDP_HEADER = 8
FILTER = (  # discards identifiers that no node receives, 0x181 to 0x5ff; low byte first
    (LOAD_BYTE, 0, 0, UDP_HEADER + 1),
    (JUMP_FROM, 5, 0, 6),
    (JUMP_ABOVE, 3, 0, 1),
    (JUMP_EQUAL, 0, 3, 1),
    (LOAD_BYTE, 0, 0, UDP_HEADER),
    (JUMP_ABOVE, 0, 1, 0x80),
    (RETURN, 0, 0, 0),
    (RETURN, 0, 0, 0xFFFFFFFF),
)


def frame_bytes(can_id: int, data: bytes, *, is_fd: bool) -> bytes:
    """Return a base-format data frame in the kernel's layout."""
    flags = FD_FRAME | BIT_RATE_SWITCH if is_fd else 0
    return (HEAD.pack(can_id, len(data), flags) + data).ljust(
        FD_BYTES if is_fd else CLASSIC_BYTES, b"\0"
    )


class SyncTap:
    """Receives SYNCs at the host's end of a cable, to get their time stamps.

    A frame on a real wire has one time. On a cable between two links of one kernel a frame gets two
    stamps, which are 50 us apart because of a timer in the kernel.
    """

    def __init__(self, channel: str) -> None:
        only = [{"can_id": SYNC_ID, "can_mask": 0x7FF, "extended": False}]
        self._bus = can.Bus(interface="socketcan", channel=channel, can_filters=only)
        self._ahead: can.Message | None = None  # received here, not yet at the devices' end

    def stamp_ns(self, stamp_ns: int, data: bytes) -> int:
        """Return the host's stamp of a SYNC [ns, CLOCK_REALTIME], or `stamp_ns` without one."""
        while (heard := self._next()) is not None:
            apart_ns = round(heard.timestamp * 1e9) - stamp_ns
            if heard.data == data and abs(apart_ns) < TAP_APART_NS:
                return stamp_ns + apart_ns
            if apart_ns > 0:
                self._ahead = heard
                break
        return stamp_ns

    def _next(self) -> can.Message | None:
        heard, self._ahead = self._ahead, None
        if heard is not None:
            return heard
        try:
            return self._bus.recv(TAP_WAIT_S)
        except can.CanError:  # the link is down; the socket works again afterwards
            return None

    def close(self) -> None:
        """Release the link."""
        self._bus.shutdown()


class FramePort:
    """One bus that sends and receives many frames at a time."""

    def __init__(self, link: BusLink) -> None:
        """Open the bus.

        Raises
        ------
        ValueError for an unknown interface, CanError or OSError if the bus cannot be opened.
        """
        self._is_fd, destination = link.fd, b""
        self._tap = None if link.stamped_at is None else SyncTap(link.stamped_at)
        if link.interface == "socketcan":  # the kernel filters, as a controller of a node does
            heard = [{"can_id": i, "can_mask": m, "extended": False} for i, m in HEARD]
            options: dict[str, Any] = {"can_filters": heard, "ignore_rx_error_frames": True}
        elif link.interface == "udp_frames":
            options = {} if link.port is None else {"port": link.port}
        else:
            raise ValueError(
                f"{link.name}: interface {link.interface}: no device is simulated on it"
            )
        name = "socketcan" if link.interface == "socketcan" else "udp_multicast"
        self._bus = can.Bus(interface=name, channel=link.channel, fd=link.fd, **options)
        self._socket = socket.socket(fileno=os.dup(self._bus.fileno()))
        if link.interface == "udp_frames":
            filtered(self._socket, FILTER)
            destination = address_of(self._socket, link.channel)
        self._in = Datagrams(self._socket, FD_BYTES, reads=True)
        self._out = Datagrams(self._socket, FD_BYTES, destination)
        self.receive_errors = 0

    def fileno(self) -> int:
        """Return the descriptor that is readable when frames wait."""
        return self._socket.fileno()

    def receive(self) -> list[HeardFrame]:
        """Return the received frames that nodes accept; none while the link is down."""
        frames: list[HeardFrame] = []
        try:
            received = self._in.receive()
        except OSError:  # the link is down; the socket works again afterwards
            self.receive_errors += 1
            return []
        for stamp_ns, datagram in received:
            if len(datagram) not in (CLASSIC_BYTES, FD_BYTES):
                self.receive_errors += 1
                continue
            can_id, length, _ = HEAD.unpack_from(datagram)
            data = datagram[HEAD.size : HEAD.size + length]
            if can_id > SFF_MASK or not is_heard(can_id):
                continue
            if len(datagram) == FD_BYTES and not self._is_fd:
                continue
            tap = self._tap if can_id == SYNC_ID else None
            at_ns = stamp_ns if tap is None else tap.stamp_ns(stamp_ns, data)
            frames.append((at_ns, can_id, data))
        return frames

    def send(self, frames: Sequence[TimedFrame]) -> int:
        """Send frames; return how many were not sent."""
        packed = [
            frame_bytes(can_id, data, is_fd=is_fd)
            for _, can_id, data, is_fd in frames
            if self._is_fd or not is_fd
        ]
        return len(frames) - len(packed) + self._out.send(packed)

    def close(self) -> None:
        """Release the bus."""
        self._socket.close()
        self._bus.shutdown()
        if self._tap is not None:
            self._tap.close()
