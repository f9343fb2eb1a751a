"""CAN ports over python-can; SocketCAN and udp_multicast sockets are read here in batches."""

import contextlib
import errno
import os
import socket
from collections.abc import Callable
from typing import Any

import can
import numpy as np
from numpy.typing import NDArray

from fsw.clock import Clock
from fsw.config import BusConfig
from fsw.drivers.ports import linux_can
from fsw.drivers.ports.packed_frames import PACKED_BYTES, Unpacker, packed
from fsw.drivers.ports.stamps import KernelStamps
from fsw.drivers.ports.system_words import of_system
from fsw.drivers.wire import (
    EFF_FLAG,
    ERR_FLAG,
    NO_FRAMES,
    RTR_FLAG,
    CanFrame,
    FrameArray,
    FramePort,
    flags_of,
    frames_from,
    joined,
    row_of,
    rows_of,
)
from fsw.errors import PortError

RECEIVE_BUFFER_BYTES = 1 << 22  # the kernel doubles it; a frame uses 768 bytes of it
MAX_BATCH = 4096  # frames per read, so that a babbling bus cannot block the loop
QUEUE_FULL = (errno.EAGAIN, errno.ENOBUFS)
UDP_MULTICAST = "udp_multicast"
UDP_FRAMES = "udp_frames"  # datagrams hold struct can_frame: replaces SocketCAN on a bench
NO_CAN = "this kernel has no CAN (SocketCAN); modprobe can_raw, or another interface"
_Stamped = tuple[linux_can.Received, NDArray[np.int64]]  # datagrams, and the time of each
LOCAL_HOP_LIMIT = 0  # udp_multicast stays on this machine


def message_row(t_ns: int, message: can.Message) -> bytes:
    """Return a python-can message as the bytes of one `FRAME`."""
    word = message.arbitration_id
    word |= EFF_FLAG * message.is_extended_id | RTR_FLAG * message.is_remote_frame
    word |= ERR_FLAG * message.is_error_frame
    flags = flags_of(is_fd=message.is_fd, bitrate_switch=message.bitrate_switch)
    return row_of(t_ns, word, bytes(message.data), flags)


def open_can(bus: BusConfig, clock: Clock) -> FramePort:
    """Open a bus with any interface of python-can.

    Raises
    ------
    PortError naming interface and channel.
    """
    options: dict[str, Any] = {"receive_own_messages": bus.interface == "socketcan"}
    interface = UDP_MULTICAST if bus.interface == UDP_FRAMES else bus.interface
    if bus.fd or interface in ("socketcan", UDP_MULTICAST):
        options["fd"] = bus.fd
    if bus.bitrate is not None:
        options["bitrate"] = bus.bitrate
    if bus.data_bitrate is not None:
        options["data_bitrate"] = bus.data_bitrate
    if interface == UDP_MULTICAST:
        options["hop_limit"] = LOCAL_HOP_LIMIT
        if bus.port is not None:
            options["port"] = bus.port
    name = f"buses.{bus.name} ({bus.interface} {bus.channel})"
    try:
        device = can.Bus(interface=interface, channel=bus.channel, **options)
    except (can.CanError, OSError, ValueError, ImportError, TypeError) as error:
        none = isinstance(error, OSError) and error.errno == errno.EAFNOSUPPORT
        words = NO_CAN if none else of_system(error)
        raise PortError(f"{name}: cannot be opened: {words}") from error
    link, group = _socket_of(device, interface or "")
    if link is None:
        return CanPort(device, clock, name)
    try:
        packs = bus.interface == UDP_MULTICAST
        return SocketPort(link, clock, name, device.shutdown, group=group, packs=packs)
    except PortError:
        device.shutdown()
        raise


def _socket_of(
    device: can.BusABC, interface: str
) -> tuple[socket.socket | None, tuple[str, int] | None]:
    """Return python-can's socket, to be read here, and its multicast group; None if absent."""
    link = group = None
    if interface == "socketcan":
        link = getattr(device, "socket", None)
    elif interface == UDP_MULTICAST:
        multicast = getattr(device, "_multicast", None)
        link = getattr(multicast, "_socket", None)
        group = getattr(multicast, "_send_destination", None)
        link = None if group is None else link
    return (link, group) if isinstance(link, socket.socket) else (None, None)


class CanPort:
    """A bus that python-can reads itself; frames are stamped when read."""

    hands_back = False

    def __init__(self, device: can.BusABC, clock: Clock, name: str) -> None:
        self._device, self._clock, self._name = device, clock, name
        self._messages: list[tuple[int, can.Message]] = []

    def drain(self) -> None:
        """Receive the waiting frames, at most `MAX_BATCH`. Raises PortError."""
        try:
            for _ in range(MAX_BATCH):
                message = self._device.recv(timeout=0)
                if message is None:
                    break
                self._messages.append((self._clock.now_ns(), message))
        except (can.CanError, OSError) as error:
            raise PortError(f"{self._name}: cannot be read: {error}") from error

    def take(self) -> Callable[[], FrameArray]:
        """Return a function that gives every frame drained since the last call."""
        messages, self._messages = self._messages, []
        return lambda: rows_of(b"".join(message_row(*item) for item in messages)).copy()

    def write(self, can_id: int, data: bytes) -> CanFrame | None:
        """Send a classic frame; return it with its stamp. Raises PortError."""
        message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
        try:
            self._device.send(message)
        except (can.CanError, OSError) as error:
            raise PortError(f"{self._name}: cannot be written: {error}") from error
        return CanFrame(self._clock.now_ns(), can_id, data)

    def take_dropped(self) -> int:
        """Return 0: python-can does not report lost frames."""
        return 0

    def wake_fds(self) -> tuple[int, ...]:
        """Return no descriptor: joint samples are timed by SYNC, not by arrival."""
        return ()

    def close(self) -> None:
        """Release the interface."""
        self._device.shutdown()


class SocketPort:
    """A bus opened by python-can whose socket is read here, in batches with kernel stamps.

    SocketCAN gives frames, udp_multicast gives them in python-can's msgpack form. Linux begins to
    stamp a moment after the first socket has requested stamps; frames before that are stamped
    when read.
    """

    hands_back = True

    def __init__(
        self,
        link: socket.socket,
        clock: Clock,
        name: str,
        release: Callable[[], None],
        *,
        group: tuple[str, int] | None = None,
        packs: bool = False,
    ) -> None:
        """Prepare an open socket.

        Parameters
        ----------
        release : function that closes the socket's owner
        group : address to which frames are sent; None: the socket's own
        packs : whether datagrams hold python-can's msgpack form

        Raises
        ------
        PortError when the bus is down.
        """
        self._socket, self._clock, self._name, self._release = link, clock, name, release
        self._group = group
        self._unpacker = Unpacker() if packs else None
        self.buffer_bytes = linux_can.prepare(link, RECEIVE_BUFFER_BYTES)
        code = link.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if code:
            raise PortError(f"{name}: cannot be opened: {os.strerror(code)}")
        slot_bytes = PACKED_BYTES if packs else linux_can.FD_BYTES
        self._receiver = linux_can.Receiver(link, slot_bytes)
        self._stamps = KernelStamps(clock)
        self._empty_ns = clock.now_ns()  # when the last drain that left nothing waiting began
        self._batches: list[_Stamped] = []  # read from the slots because all were full

    def drain(self) -> None:
        """Receive the waiting frames. Raises PortError.

        The kernel reports an error before the frames behind it; a second drain receives these.
        """
        try:
            self._drain()
        except OSError as error:
            with contextlib.suppress(OSError):
                self._drain()
            raise PortError(f"{self._name}: cannot be read: {error}") from error

    def _drain(self) -> None:
        began_ns = self._clock.now_ns()
        for _ in range(MAX_BATCH // linux_can.SLOTS):
            if self._receiver.drain():
                self._empty_ns = began_ns
                return
            self._batches.append(self._stamped())

    def take(self) -> Callable[[], FrameArray]:
        """Return a function that gives the frames drained since the last call, kernel-stamped."""
        batches, self._batches = [*self._batches, self._stamped()], []
        self._stamps.left_empty(self._empty_ns)
        return lambda: joined([self._frames(*batch) for batch in batches])

    def _stamped(self) -> _Stamped:
        batch = self._receiver.read()
        return batch, self._stamps.monotonic_ns(batch.realtime_ns)

    def _frames(self, batch: linux_can.Received, times_ns: NDArray[np.int64]) -> FrameArray:
        if not len(times_ns):
            return NO_FRAMES
        if self._unpacker is not None:
            return self._unpacker.frames(batch, times_ns)
        return frames_from(times_ns, batch.data, batch.lengths)

    def take_dropped(self) -> int:
        """Return how many frames found no room in the receive buffer since the last call."""
        dropped, self._receiver.dropped = self._receiver.dropped, 0
        return dropped

    def write(self, can_id: int, data: bytes) -> CanFrame | None:
        """Send a classic frame; return it with its stamp, None when the transmit queue is full."""
        try:
            form = linux_can.pack_classic if self._unpacker is None else packed
            if self._group is not None:
                self._socket.sendto(form(can_id, data), socket.MSG_DONTWAIT, self._group)
            else:
                self._socket.send(form(can_id, data), socket.MSG_DONTWAIT)
        except OSError as error:
            if error.errno in QUEUE_FULL:
                return None
            with contextlib.suppress(PortError):
                self.drain()  # what came before the bus went down
            raise PortError(f"{self._name}: cannot be written: {error}") from error
        return CanFrame(self._clock.now_ns(), can_id, data)

    def wake_fds(self) -> tuple[int, ...]:
        """Return no descriptor: joint samples are timed by SYNC, not by arrival."""
        return ()

    def close(self) -> None:
        """Release the interface."""
        self._release()
