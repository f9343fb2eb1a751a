"""Measure frames through the ports of the loop and, as references, through python-can.

For each reader, a sender in another process sends numbered frames; the reader drains them 500 times
a second, as the loop does. The counts of frames sent and received show how many were lost.
"""

import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import can
import numpy as np

from fsw.clock import MonotonicClock
from fsw.config import BusConfig
from fsw.drivers.ports.can_bus import SocketPort, open_can
from fsw.drivers.wire import FrameArray, FramePort
from offline.bench.load import sender, sent_by

SOCKET, MULTICAST = "Linux frames over a socket", "udp_multicast"
RECV, NOTIFIER = "python-can recv", "python-can Notifier"
GROUP = "239.74.163.7"
TICK_NS, BATCH_TICKS = 2_000_000, 20
SETTLE_S = 0.3  # reading continues this long after the sender's end
STALLS_S = (0.3, 5.0)  # the buffer holds the frames of the first stall, not those of the second


@dataclass(frozen=True, slots=True)
class Flow:
    """Frames of one round through one reader."""

    sent: int
    received: int
    seconds: float
    cpu_s: float
    counted: int = 0  # lost frames that the port counted itself

    @property
    def lost(self) -> int:
        """Frames sent and not received."""
        return self.sent - self.received

    @property
    def frames_per_s(self) -> float:
        """Rate of frames sent [1/s]."""
        return self.sent / self.seconds

    @property
    def us_per_frame(self) -> float:
        """Processor time of one received frame [us]."""
        return self.cpu_s / max(1, self.received) * 1e6

    @property
    def core_percent(self) -> float:
        """Share of a processor core [%]."""
        return 100.0 * self.cpu_s / self.seconds


class _Ours:
    """Drains a port of the loop every tick and decodes its frames once a batch."""

    def __init__(self, port: FramePort) -> None:
        self._port, self._ticks = port, 0
        self.frames: list[FrameArray] = []

    def tick(self) -> None:
        self._port.drain()
        self._ticks += 1
        if self._ticks % BATCH_TICKS == 0:
            self.frames.append(self._port.take()())

    def received(self) -> int:
        self._port.drain()
        self.frames.append(self._port.take()())
        data = np.concatenate(self.frames)["data"][:, :8]
        return len(np.unique(np.ascontiguousarray(data).view(np.int64)))


class _Recv:
    """Calls python-can's `recv` every tick until no frame is left."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus, self._count = bus, 0

    def tick(self) -> None:
        while self._bus.recv(timeout=0) is not None:
            self._count += 1

    def received(self) -> int:
        self.tick()
        return self._count


class _Notified:
    """Counts the frames that python-can's Notifier passes to it from a separate thread."""

    def __init__(self, bus: can.BusABC) -> None:
        self._count = 0
        self._notifier = can.Notifier(bus, [self._hear])

    def _hear(self, _message: can.Message) -> None:
        self._count += 1

    def tick(self) -> None:
        """Do nothing: the Notifier's thread reads the frames."""

    def received(self) -> int:
        self._notifier.stop()
        return self._count


def _flow(
    reader: _Ours | _Recv | _Notified,
    place: tuple[str, str],
    rate_hz: float,
    seconds: float,
    stall_s: float = 0.0,
) -> tuple[int, int, float]:
    """Run a sender, tick the reader, pause once for `stall_s`; return sent, received, CPU [s]."""
    clock = MonotonicClock()
    with sender(*place, rate_hz, seconds) as process:
        cpu_s, due_ns = clock.process_cpu_s(), clock.now_ns()
        end_ns = None
        while end_ns is None or clock.now_ns() < end_ns:
            due_ns = max(due_ns + TICK_NS, clock.now_ns())
            if stall_s and end_ns is None and process.poll() is None:
                due_ns += round(stall_s * 1e9)
                stall_s = 0.0
            clock.sleep_until_ns(due_ns)
            reader.tick()
            if end_ns is None and process.poll() is not None:
                end_ns = clock.now_ns() + round(SETTLE_S * 1e9)
        cpu_s = clock.process_cpu_s() - cpu_s
        return sent_by(process), reader.received(), cpu_s


def over_socket(rate_hz: float, seconds: float, stall_s: float = 0.0) -> Flow:
    """Read frames in the layout of SocketCAN from a UDP socket of the loopback interface."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        port = SocketPort(link, MonotonicClock(), "bench", link.close)
        place = ("socket", str(link.getsockname()[1]))
        sent, received, cpu_s = _flow(_Ours(port), place, rate_hz, seconds, stall_s)
        return Flow(sent, received, seconds, cpu_s, port.take_dropped())


def over_multicast(rate_hz: float, seconds: float) -> Flow:
    """Read python-can's udp_multicast through the port of the loop."""
    number = _free_port()
    config = BusConfig(
        name="bench", interface="udp_multicast", channel=GROUP, port=number, rate_hz=500.0
    )
    port = open_can(config, MonotonicClock())
    try:
        place = ("multicast", f"{GROUP}:{number}")
        sent, received, cpu_s = _flow(_Ours(port), place, rate_hz, seconds)
        return Flow(sent, received, seconds, cpu_s, port.take_dropped())
    finally:
        port.close()


def by_python_can(
    make: Callable[[can.BusABC], _Recv | _Notified], rate_hz: float, seconds: float
) -> Flow:
    """Read udp_multicast with the python-can reader that `make` returns."""
    number = _free_port()
    bus = can.Bus(interface="udp_multicast", channel=GROUP, port=number, hop_limit=0)
    try:
        place = ("multicast", f"{GROUP}:{number}")
        sent, received, cpu_s = _flow(make(bus), place, rate_hz, seconds)
        return Flow(sent, received, seconds, cpu_s)
    finally:
        bus.shutdown()


def stalled(rate_hz: float, stall_s: float) -> Flow:
    """Read from a socket, but pause for `stall_s` [s] while frames arrive."""
    return over_socket(rate_hz, stall_s + 1.0, stall_s)


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        number: int = probe.getsockname()[1]
    return number


READERS: Mapping[str, Callable[[float, float], Flow]] = {
    SOCKET: over_socket,
    MULTICAST: over_multicast,
    RECV: lambda rate_hz, seconds: by_python_can(_Recv, rate_hz, seconds),
    NOTIFIER: lambda rate_hz, seconds: by_python_can(_Notified, rate_hz, seconds),
}
