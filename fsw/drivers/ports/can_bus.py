"""CAN port over python-can; a SocketCAN socket is drained directly, in batches."""

from __future__ import annotations

import socket
import struct
from collections import deque
from typing import Any

import can

from fsw.clock import Clock
from fsw.config import BusConfig
from fsw.drivers.wire import CanFrame
from fsw.errors import PortError

RECEIVE_BUFFER_BYTES = 1 << 20  # a frame charges 768 of them
MAX_BATCH = 4096  # frames per read, so that a babbling bus cannot hold the loop
MAX_ECHOES = 64  # frames sent and not seen back
LOCAL_HOP_LIMIT = 0  # udp_multicast stays on this machine
_HEADER = struct.Struct("=IBB2x")
_EFF, _RTR, _ERR = socket.CAN_EFF_FLAG, socket.CAN_RTR_FLAG, socket.CAN_ERR_FLAG
_CLASSIC_BYTES, _FD_BYTES = 16, 72
_BRS = 0x01


def open_can(bus: BusConfig, clock: Clock) -> CanPort:
    """Open a bus of any of python-can's interfaces.

    Raises
    ------
    PortError naming interface and channel.
    """
    options: dict[str, Any] = {"receive_own_messages": False}
    if bus.fd or bus.interface in ("socketcan", "udp_multicast"):
        options["fd"] = bus.fd
    if bus.bitrate is not None:
        options["bitrate"] = bus.bitrate
    if bus.data_bitrate is not None:
        options["data_bitrate"] = bus.data_bitrate
    if bus.interface == "udp_multicast":
        options["hop_limit"] = LOCAL_HOP_LIMIT
        if bus.port is not None:
            options["port"] = bus.port
    name = f"buses.{bus.name} ({bus.interface} {bus.channel})"
    try:
        device = can.Bus(interface=bus.interface, channel=bus.channel, **options)
    except (can.CanError, OSError, ValueError, ImportError, TypeError) as error:
        raise PortError(f"{name}: cannot be opened: {error}") from error
    link = getattr(device, "socket", None)
    if bus.interface == "socketcan" and isinstance(link, socket.socket):
        return SocketCanPort(device, link, clock, name)
    return CanPort(device, clock, name, echoes=bus.interface == "udp_multicast")


class CanPort:
    """Any python-can bus.

    With `echoes` the interface hands back what was sent (udp_multicast does); that is dropped.
    """

    def __init__(
        self, device: can.BusABC, clock: Clock, name: str, *, echoes: bool = False
    ) -> None:
        self._echoes: deque[tuple[int, bytes]] | None = None
        if echoes:
            self._echoes = deque(maxlen=MAX_ECHOES)
        self._device = device
        self._clock = clock
        self._name = name

    def read(self) -> list[CanFrame]:
        """Return every frame received since the last call."""
        frames: list[CanFrame] = []
        try:
            while len(frames) < MAX_BATCH:
                message = self._device.recv(timeout=0)
                if message is None:
                    break
                if self._echoes and self._is_echo(message):
                    continue
                frames.append(
                    CanFrame(
                        self._clock.now_ns(),
                        message.arbitration_id,
                        bytes(message.data),
                        message.is_fd,
                        message.is_extended_id,
                        message.is_remote_frame,
                        message.is_error_frame,
                        message.bitrate_switch,
                    )
                )
        except (can.CanError, OSError) as error:
            raise PortError(f"{self._name}: cannot be read: {error}") from error
        return frames

    def write(self, can_id: int, data: bytes) -> CanFrame:
        """Send a classic frame and stamp it."""
        message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
        try:
            self._device.send(message)
        except (can.CanError, OSError) as error:
            raise PortError(f"{self._name}: cannot be written: {error}") from error
        t_ns = self._clock.now_ns()
        if self._echoes is not None:
            self._echoes.append((can_id, data))
        return CanFrame(t_ns, can_id, data)

    def _is_echo(self, message: can.Message) -> bool:
        """Tell whether this is the oldest frame sent that has not come back yet."""
        sent = (message.arbitration_id, bytes(message.data))
        if self._echoes is None or sent not in self._echoes:
            return False
        while self._echoes.popleft() != sent:
            pass  # an echo before it was lost
        return True

    def wake_fds(self) -> tuple[int, ...]:
        """Return nothing: joint samples are timed by SYNC, not by arrival."""
        return ()

    def close(self) -> None:
        """Release the interface."""
        self._device.shutdown()


class SocketCanPort(CanPort):
    """A SocketCAN bus: same sending, the socket read without python-can's cost per frame."""

    def __init__(self, device: can.BusABC, link: socket.socket, clock: Clock, name: str) -> None:
        super().__init__(device, clock, name)
        self._socket = link
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)

    def read(self) -> list[CanFrame]:
        """Return every frame received since the last call, one stamp for all."""
        raw: list[bytes] = []
        try:
            while len(raw) < MAX_BATCH:
                raw.append(self._socket.recv(_FD_BYTES, socket.MSG_DONTWAIT))
        except BlockingIOError:
            pass
        except OSError as error:
            raise PortError(f"{self._name}: cannot be read: {error}") from error
        if not raw:
            return []
        t_ns = self._clock.now_ns()
        return [frame_of(data, t_ns) for data in raw if len(data) in (_CLASSIC_BYTES, _FD_BYTES)]


def frame_of(data: bytes, t_ns: int) -> CanFrame:
    """Return the frame a Linux `can_frame` (16 bytes) or `canfd_frame` (72 bytes) holds."""
    word, length, flags = _HEADER.unpack_from(data)
    is_fd = len(data) == _FD_BYTES
    extended = bool(word & _EFF)
    mask = socket.CAN_EFF_MASK if extended else socket.CAN_SFF_MASK
    return CanFrame(
        t_ns,
        word & mask,
        data[8 : 8 + length],
        is_fd,
        extended,
        bool(word & _RTR),
        bool(word & _ERR),
        is_fd and bool(flags & _BRS),
    )
