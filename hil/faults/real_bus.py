"""Faults of a real SocketCAN link, for runs in `hil vcan`: error frames, babble, a link down.

They act on links of the kernel; virtual links have the taps of `hil.faults.taps`.
"""

import fcntl
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from enum import Enum

import can
import numpy as np

BABBLE_STREAM = 0xBAB
BABBLE_FRAMES, BABBLE_PAUSE_S = 256, 0.005
CAN_FRAME = struct.Struct("=IB3x8s")  # layout of linux/can.h
POLL_S = 0.05
SIOCGIFFLAGS, SIOCSIFFLAGS, IFF_UP = 0x8913, 0x8914, 1  # netdevice(7)
IFNAMSIZ, IFREQ_BYTES = 16, 40


class ErrorKind(Enum):
    """Error frames of a CAN controller's driver: class bits and data (linux/can/error.h)."""

    BUS_OFF = (0x040, "0000000000000000")
    RESTARTED = (0x100, "0000000000000000")
    ERROR_PASSIVE = (0x204, "0020000000008000")
    ERROR_WARNING = (0x204, "0008000000006000")
    ERROR_ACTIVE = (0x204, "0040000000000000")
    ARBITRATION_LOST = (0x002, "0b00000000000000")
    NO_ACKNOWLEDGE = (0x020, "0000000000000000")
    CONTROLLER_OVERFLOW = (0x004, "0001000000000000")
    FORM_ERROR = (0x088, "0000020000000000")


def inject(channel: str, *kinds: ErrorKind) -> None:
    """Send error frames on a link; listeners accept them as frames of their own controller."""
    with can.Bus(interface="socketcan", channel=channel) as bus:
        for kind in kinds:
            classes, data = kind.value
            message = can.Message(
                arbitration_id=classes, data=bytes.fromhex(data), is_error_frame=True
            )
            bus.send(message)


def set_link(channel: str, *, up: bool) -> None:
    """Set a link up or down; while it is down, every socket on it fails with ENETDOWN."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ends:  # faster than the program `ip`
        request = channel.encode().ljust(IFNAMSIZ, b"\0")
        held = fcntl.ioctl(ends, SIOCGIFFLAGS, request + bytes(IFREQ_BYTES - IFNAMSIZ))
        (flags,) = struct.unpack_from("=H", held, IFNAMSIZ)
        flags = flags | IFF_UP if up else flags & ~IFF_UP
        wanted = request + struct.pack("=H", flags)
        fcntl.ioctl(ends, SIOCSIFFLAGS, wanted.ljust(IFREQ_BYTES, b"\0"))


class Babble:
    """A node that sends frames of random length and content at a given rate."""

    def __init__(self, channel: str, can_id: int, rate_hz: float, seed: int) -> None:
        self._channel, self._can_id, self._rate_hz = channel, can_id, rate_hz
        sequence = np.random.SeedSequence(seed, spawn_key=(BABBLE_STREAM,))
        self._rng = np.random.default_rng(sequence)
        self._stop = threading.Event()
        self.sent = 0

    def run(self) -> None:
        """Send frames until `stop` is called.

        The frames are made in advance, and all due frames are sent at once, so that a busy
        processor does not reduce the rate.
        """
        frames = [self._frame() for _ in range(BABBLE_FRAMES)]
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as link:
            link.bind((self._channel,))
            began_s = time.monotonic()
            while not self._stop.wait(BABBLE_PAUSE_S):
                due = int((time.monotonic() - began_s) * self._rate_hz)
                while self.sent < due:
                    link.send(frames[self.sent % BABBLE_FRAMES])
                    self.sent += 1

    def _frame(self) -> bytes:
        data = self._rng.bytes(int(self._rng.integers(0, 9)))
        return CAN_FRAME.pack(self._can_id, len(data), data)

    def stop(self) -> None:
        """End the sending."""
        self._stop.set()


class Echo:
    """A faulty repeater that sends some of the frames of one identifier a second time."""

    def __init__(self, channel: str, can_id: int, later_s: float, ratio: float, seed: int) -> None:
        self._channel, self._can_id = channel, can_id
        self._later_s, self._ratio = later_s, ratio
        sequence = np.random.SeedSequence(seed, spawn_key=(BABBLE_STREAM,))
        self._rng = np.random.default_rng(sequence)
        self._stop = threading.Event()
        self.sent = 0

    def run(self) -> None:
        """Repeat frames until `stop` is called."""
        only = [{"can_id": self._can_id, "can_mask": 0x7FF}]
        with can.Bus(interface="socketcan", channel=self._channel, can_filters=only) as bus:
            while not self._stop.is_set():
                message = bus.recv(POLL_S)
                if message is None or self._rng.random() >= self._ratio:
                    continue
                self._stop.wait(self._later_s)
                bus.send(message)
                self.sent += 1

    def stop(self) -> None:
        """End the repeating."""
        self._stop.set()


@contextmanager
def running(disturbance: Babble | Echo) -> Iterator[None]:
    """Run a disturbance in a thread during the block; raise the error that ended it early."""
    with ThreadPoolExecutor(1, "disturbance") as pool:
        ended = pool.submit(disturbance.run)
        try:
            yield
        finally:
            disturbance.stop()
            ended.result()


@contextmanager
def cable(*ends: str) -> Iterator[None]:
    """Make two connected links with these names, both up; each receives the other's frames."""
    near, far = ends
    words = ["ip", "link", "add", "dev", near, "type", "vxcan", "peer", "name", far]
    subprocess.run(words, check=True)
    try:
        for end in ends:
            set_link(end, up=True)
        yield
    finally:
        subprocess.run(["ip", "link", "delete", "dev", near], check=True)


def send(channel: str, can_id: int, data: bytes) -> None:
    """Send one frame."""
    with can.Bus(interface="socketcan", channel=channel) as bus:
        bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))


@contextmanager
def babbling(channel: str, can_id: int, rate_hz: float, seed: int) -> Iterator[Babble]:
    """Run a babbling node in a thread during the block."""
    babble = Babble(channel, can_id, rate_hz, seed)
    with running(babble):
        yield babble
