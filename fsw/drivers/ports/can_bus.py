"""CAN port over python-can; a SocketCAN socket is drained directly, in batches."""

from __future__ import annotations

import errno
import os
import socket
from typing import Any

import can

from fsw.clock import Clock
from fsw.config import BusConfig
from fsw.drivers.ports import linux_can
from fsw.drivers.ports.stamps import KernelStamps
from fsw.drivers.wire import CanFrame, FramePort, unpack_frame
from fsw.messages.errors import PortError

RECEIVE_BUFFER_BYTES = 1 << 20  # a frame charges 768 of them
MAX_BATCH = 4096  # frames per read, so that a babbling bus cannot hold the loop
QUEUE_FULL = (errno.EAGAIN, errno.ENOBUFS)
LOCAL_HOP_LIMIT = 0  # udp_multicast stays on this machine


def open_can(bus: BusConfig, clock: Clock) -> FramePort:
    """Open a bus of any of python-can's interfaces.

    Raises
    ------
    PortError naming interface and channel.
    """
    options: dict[str, Any] = {"receive_own_messages": bus.interface == "socketcan"}
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
        try:
            return SocketCanPort(device, link, clock, name)
        except PortError:
            device.shutdown()
            raise
    return CanPort(device, clock, name, stamped=bus.interface == "udp_multicast")


class CanPort:
    """Any python-can bus.

    With `stamped` its messages carry the kernel's stamps and what is sent comes back (as
    udp_multicast has it), else they are stamped when read. So are the first ones where no socket of
    the machine had asked for stamps before: Linux switches them on a moment later.
    """

    def __init__(
        self, device: can.BusABC, clock: Clock, name: str, *, stamped: bool = False
    ) -> None:
        self._device, self._clock, self._name = device, clock, name
        self.hands_back = stamped
        self._stamps = KernelStamps(clock) if stamped else None

    def read(self) -> list[CanFrame]:
        """Return every frame received since the last call."""
        began_ns = self._clock.now_ns()
        messages: list[can.Message] = []
        try:
            while len(messages) < MAX_BATCH:
                message = self._device.recv(timeout=0)
                if message is None:
                    break
                messages.append(message)
        except (can.CanError, OSError) as error:
            raise PortError(f"{self._name}: cannot be read: {error}") from error
        if messages and self._stamps is not None:
            times_ns = self._stamps.monotonic_ns(round(m.timestamp * 1e9) for m in messages)
        else:
            times_ns = [self._clock.now_ns()] * len(messages)
        if self._stamps is not None and len(messages) < MAX_BATCH:
            self._stamps.left_empty(began_ns)
        return [
            CanFrame(
                t_ns,
                message.arbitration_id,
                bytes(message.data),
                message.is_fd,
                message.is_extended_id,
                message.is_remote_frame,
                message.is_error_frame,
                message.bitrate_switch,
            )
            for t_ns, message in zip(times_ns, messages, strict=True)
        ]

    def write(self, can_id: int, data: bytes) -> CanFrame:
        """Send a classic frame and stamp it."""
        message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
        try:
            self._device.send(message)
        except (can.CanError, OSError) as error:
            raise PortError(f"{self._name}: cannot be written: {error}") from error
        return CanFrame(self._clock.now_ns(), can_id, data)

    def take_dropped(self) -> int:
        """Return 0: python-can does not tell."""
        return 0

    def wake_fds(self) -> tuple[int, ...]:
        """Return nothing: joint samples are timed by SYNC, not by arrival."""
        return ()

    def close(self) -> None:
        """Release the interface."""
        self._device.shutdown()


class SocketCanPort:
    """A SocketCAN bus: opened by python-can, its socket served without python-can's cost per frame.

    Frames carry the kernel's stamps (`KernelStamps`).
    """

    hands_back = True

    def __init__(self, device: can.BusABC, link: socket.socket, clock: Clock, name: str) -> None:
        self._device, self._socket, self._clock, self._name = device, link, clock, name
        self.buffer_bytes = linux_can.prepare(link, RECEIVE_BUFFER_BYTES)
        code = link.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if code:
            raise PortError(f"{name}: cannot be opened: {os.strerror(code)}")
        self._receiver = linux_can.Receiver(link)
        self._stamps = KernelStamps(clock)
        self._failure: OSError | None = None

    def read(self) -> list[CanFrame]:
        """Return every frame received since the last call, with its kernel stamp."""
        frames: list[CanFrame] = []
        began_ns = self._clock.now_ns()
        failure, self._failure = self._failure, None
        while failure is None and len(frames) < MAX_BATCH:
            try:
                batch = self._receiver.receive()
            except OSError as error:
                failure = error
                batch = self._rest()
            frames += self._stamped(batch)
            if len(batch) < linux_can.BATCH:
                self._stamps.left_empty(began_ns)
                break
        if frames:
            self._failure = failure  # told by the next read
        elif failure is not None:
            raise PortError(f"{self._name}: cannot be read: {failure}") from failure
        return frames

    def _rest(self) -> list[linux_can.Received]:
        """Return what came before the error the kernel has just told, once."""
        try:
            return self._receiver.receive()
        except OSError:
            return []

    def _stamped(self, batch: list[linux_can.Received]) -> list[CanFrame]:
        if not batch:
            return []
        times_ns = self._stamps.monotonic_ns(frame.realtime_ns for frame in batch)
        frames = map(unpack_frame, times_ns, (received.data for received in batch))
        return [frame for frame in frames if frame is not None]

    def take_dropped(self) -> int:
        """Return and forget how many frames the receive buffer had no room for."""
        dropped, self._receiver.dropped = self._receiver.dropped, 0
        return dropped

    def write(self, can_id: int, data: bytes) -> CanFrame | None:
        """Send a classic frame and stamp it; None when the transmit queue is full."""
        try:
            self._socket.send(linux_can.pack_classic(can_id, data), socket.MSG_DONTWAIT)
        except OSError as error:
            if error.errno in QUEUE_FULL:
                return None
            raise PortError(f"{self._name}: cannot be written: {error}") from error
        return CanFrame(self._clock.now_ns(), can_id, data)

    def wake_fds(self) -> tuple[int, ...]:
        """Return nothing: joint samples are timed by SYNC, not by arrival."""
        return ()

    def close(self) -> None:
        """Release the interface."""
        self._device.shutdown()
