"""Measure bytes over a pseudo-terminal through the loop's serial port and through pyserial."""

import os
import select
import tty
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import serial

from fsw.clock import MonotonicClock
from fsw.drivers.ports.serial_line import open_serial
from offline.bench.load import sender

OURS, PYSERIAL = "port of the loop", "pyserial"
BAUD = 921_600
WAIT_S = 0.2


@dataclass(frozen=True, slots=True)
class Flow:
    """Bytes of one round through one reader."""

    received: int
    seconds: float
    cpu_s: float

    @property
    def bytes_per_s(self) -> float:
        """Rate of bytes read [1/s]."""
        return self.received / self.seconds

    @property
    def us_per_kilobyte(self) -> float:
        """Processor time of a thousand received bytes [us]."""
        return self.cpu_s / max(1, self.received) * 1e9


def _flow(master: int, fd: int, read: Callable[[], int], seconds: float) -> Flow:
    """Read from `fd` all bytes that a sender writes to `master`."""
    clock, received = MonotonicClock(), 0
    with sender("line", str(master), 0.0, seconds) as process:
        began_ns = ended_ns = 0
        cpu_s = clock.process_cpu_s()
        while process.poll() is None or select.select([fd], [], [], 0.0)[0]:
            if not select.select([fd], [], [], WAIT_S)[0]:
                continue
            began_ns = began_ns or clock.now_ns()
            received += read()
            ended_ns = clock.now_ns()
        cpu_s = clock.process_cpu_s() - cpu_s
    return Flow(received, max(1e-9, (ended_ns - began_ns) * 1e-9), cpu_s)


def by_port(seconds: float) -> Flow:
    """Send bytes for `seconds`, read them through the loop's serial port, and measure."""
    master, slave = os.openpty()
    tty.setraw(slave)
    port = open_serial(os.ttyname(slave), BAUD, MonotonicClock())
    try:
        (fd,) = port.wake_fds()
        return _flow(master, fd, lambda: sum(len(c.data) for c in port.read()), seconds)
    finally:
        port.close()
        os.close(slave)
        os.close(master)


def by_pyserial(seconds: float) -> Flow:
    """Read with pyserial, each time as many bytes as it reports to be waiting."""
    master, slave = os.openpty()
    tty.setraw(slave)
    with serial.Serial(os.ttyname(slave), BAUD, timeout=0) as line:
        try:
            return _flow(
                master, line.fileno(), lambda: len(line.read(line.in_waiting or 1)), seconds
            )
        finally:
            os.close(slave)
            os.close(master)


READERS: Mapping[str, Callable[[float], Flow]] = {OURS: by_port, PYSERIAL: by_pyserial}
