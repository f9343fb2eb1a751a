"""The loop process: the daemon on the machine's clock and devices, until SIGTERM or SIGINT."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from types import FrameType
from typing import TypeVar

from fsw import realtime
from fsw.clock import Clock, MonotonicClock
from fsw.config import Config
from fsw.daemon import IMU, STAR_TRACKER, Daemon, Ports, build
from fsw.drivers.wire import BytePort, FramePort
from fsw.errors import PortError
from fsw.messages import Event
from fsw.pipeline import Pipeline
from fsw.ring import RingReader, RingWriter
from fsw.ringlink import DOWN_BYTES, UP_BYTES, RingJobs, RingSink
from fsw.sinks import Sink

__all__ = ["Daemon", "Pipeline", "Ports", "build", "open_ports", "run_live"]

SERVICE_WAIT_S = 20.0  # for the service to write what is left
P = TypeVar("P", FramePort, BytePort)


class StopSignal:
    """Remembers SIGTERM and SIGINT."""

    def __init__(self) -> None:
        self.received = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._receive)

    def _receive(self, _number: int, _frame: FrameType | None) -> None:
        self.received = True


def open_ports(config: Config, clock: Clock, sink: Sink) -> Ports:
    """Open every configured port; one that fails counts as lost and is tried again later."""
    from fsw.drivers.ports.can_bus import open_can
    from fsw.drivers.ports.serial_line import open_serial

    def attempt(name: str, opener: Callable[[], P]) -> P | None:
        try:
            return opener()
        except PortError as error:
            sink.event(Event(clock.now_ns(), "high", "PORT_LOST", f"{name}: {error}"))
            return None

    cans: dict[str, Callable[[], FramePort]] = {
        bus.name: partial(open_can, bus, clock) for bus in config.buses
    }
    imu, tracker = config.imu, config.star_tracker
    lines: dict[str, Callable[[], BytePort]] = {
        IMU: partial(open_serial, imu.port, imu.baud_rate, clock)
    }
    if tracker is not None:
        lines[STAR_TRACKER] = partial(open_serial, tracker.port, tracker.baud_rate, clock)
    opened = {name: attempt(name, opener) for name, opener in lines.items()}
    return Ports(
        can={name: attempt(f"can/{name}", opener) for name, opener in cans.items()},
        imu=opened[IMU],
        star_tracker=opened.get(STAR_TRACKER),
        can_openers=cans,
        line_openers=lines,
    )


def start_service(down_fd: int, up_fd: int) -> subprocess.Popen[bytes]:
    """Start the service process on the two rings; it is not waited for."""
    command = [sys.executable, "-m", "fsw.service", "--down", str(down_fd), "--up", str(up_fd)]
    return subprocess.Popen(
        command,
        pass_fds=(down_fd, up_fd),
        stdin=subprocess.DEVNULL,
        start_new_session=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )


def run_live(config: Config) -> int:
    """Run until told to stop; return the exit code."""
    stop = StopSignal()
    clock = MonotonicClock()
    down, up = RingWriter.create(DOWN_BYTES), RingWriter.create(UP_BYTES)
    service = start_service(down.fd, up.fd)
    sink = RingSink(down)
    sink.config(config)
    jobs = RingJobs(down, RingReader(os.dup(up.fd)))
    daemon = build(config, clock, open_ports(config, clock, sink), sink, jobs=jobs)
    for text in realtime.prepare(config.scheduler):
        sink.event(Event(clock.now_ns(), "low", "REALTIME", text))
    realtime.freeze_garbage()
    ticks_per_s = max(1, round(config.scheduler.tick_rate_hz))
    served = True
    while not (stop.received or daemon.dispatcher.stop_requested):
        tick = daemon.step()
        for command in jobs.commands():
            daemon.submit(command)
        if tick.index % ticks_per_s == ticks_per_s - 1:
            realtime.collect_young()
            served = served and _watch(service, sink, clock)
    daemon.shutdown()
    try:
        service.wait(SERVICE_WAIT_S)
    except subprocess.TimeoutExpired:
        return 1
    return 0


def _watch(service: subprocess.Popen[bytes], sink: Sink, clock: Clock) -> bool:
    """Tell once when the service has ended; True while it lives."""
    if service.poll() is None:
        return True
    text = f"service process ended with {service.returncode}; nothing is recorded"
    sink.event(Event(clock.now_ns(), "high", "SERVICE_LOST", text))
    return False
