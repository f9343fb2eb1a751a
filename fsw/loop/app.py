"""The loop process: the daemon on the machine's clock and devices, until SIGTERM or SIGINT."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from functools import partial
from types import FrameType
from typing import TypeVar

from fsw.clock import Clock, MonotonicClock
from fsw.config import Config
from fsw.drivers.wire import BytePort, FramePort
from fsw.exchange.checkpoint_store import CheckpointStore, boot_id, identity_of
from fsw.exchange.restart import judge
from fsw.exchange.sinks import Sink
from fsw.loop import realtime
from fsw.loop.daemon import Daemon
from fsw.loop.notify import Notifier
from fsw.loop.ports import IMU, SECOND, STAR_TRACKER, Ports
from fsw.loop.service_process import ServiceProcess, lock_state
from fsw.loop.wiring import build
from fsw.messages import Event
from fsw.messages.errors import PortError
from fsw.scheduler.tasks import is_due

__all__ = ["Daemon", "Ports", "build", "open_ports", "run_live"]

RESTART_EXIT = 75  # the caller is to start again
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
            sink.put(Event(clock.now_ns(), "high", "PORT_LOST", f"{name}: {error}"))
            return None

    cans: dict[str, Callable[[], FramePort]] = {}
    for bus in config.buses:
        cans[bus.name] = partial(open_can, bus, clock)
        second = bus.second()
        if second is not None:
            cans[bus.name + SECOND] = partial(open_can, second, clock)
    imu, tracker = config.imu, config.star_tracker
    lines: dict[str, Callable[[], BytePort]] = {}
    if imu.present:
        lines[IMU] = partial(open_serial, config.device(imu.port), imu.baud_rate, clock)
    if tracker is not None:
        path = config.device(tracker.port)
        lines[STAR_TRACKER] = partial(open_serial, path, tracker.baud_rate, clock)
    opened = {name: attempt(name, opener) for name, opener in lines.items()}
    return Ports(
        can={name: attempt(f"can/{name}", opener) for name, opener in cans.items()},
        imu=opened.get(IMU),
        star_tracker=opened.get(STAR_TRACKER),
        can_openers=cans,
        line_openers=lines,
    )


def run_live(config: Config, *, cold: bool = False) -> int:
    """Run until it is stopped; return the exit code. `cold` ignores checkpoints.

    Returns RESTART_EXIT when a restart was commanded.

    Raises
    ------
    PortError when another daemon runs on the same state directory.
    """
    stop, notifier = StopSignal(), Notifier(os.environ)
    clock = MonotonicClock()
    lock_state(config.resolve(config.service.state_directory), clock)
    if config.telemetry is not None:
        from fsw.telemetry.tables.effective import (
            effective_config,  # only where something can come up
        )

        config = effective_config(config)
    service = ServiceProcess(config, clock)
    sink = service.sink
    _import_all()
    sink.put(Event(clock.now_ns(), "info", "STARTED", f"imports done; process {os.getpid()}"))
    daemon = build(config, clock, open_ports(config, clock, sink), sink)
    if not cold and config.service.checkpoint_period_s is not None:
        go_on(daemon, config, clock, sink)
    for text in realtime.prepare(config.scheduler):
        sink.put(Event(clock.now_ns(), "low", "REALTIME", text))
    realtime.freeze_garbage()
    ticks_per_s = max(1, round(config.scheduler.tick_rate_hz))
    notifier.send("READY=1")

    def turn() -> int:
        index = daemon.step().index
        for command in service.commands():
            daemon.submit(command)
        return index

    def each_second() -> None:
        realtime.collect_young()
        if service.watch():
            notifier.send("WATCHDOG=1")

    drive(turn, each_second, ticks_per_s, lambda: stop.received or daemon.dispatcher.stop_requested)
    notifier.send("STOPPING=1")
    daemon.shutdown()
    ended = service.wait(SERVICE_WAIT_S)
    if daemon.dispatcher.restart_requested:
        return RESTART_EXIT
    return 0 if ended else 1


def drive(
    turn: Callable[[], int],
    each_second: Callable[[], None],
    ticks_per_s: int,
    ended: Callable[[], bool],
) -> None:
    """Turn until the end; once a second of the grid do what is due, whichever ticks were missed.

    Parameters
    ----------
    turn : runs a tick and returns its index on the grid
    """
    index = 0
    while not ended():
        before, index = index, turn()
        if is_due(ticks_per_s, index, before):
            each_second()


def _import_all() -> None:
    """Import what the loop needs and has not imported yet: the heavy libraries."""
    import fsw.drivers.ports.can_bus
    import fsw.drivers.ports.serial_line
    import fsw.drivers.sources
    import fsw.estimators.conditioning
    import fsw.estimators.model.robot
    import fsw.estimators.recursive.online  # noqa: F401


def go_on(daemon: Daemon, config: Config, clock: Clock, sink: Sink) -> bool:
    """Continue from the newest good checkpoint; why others were refused are events."""
    directory = config.resolve(config.service.state_directory)
    try:
        store = CheckpointStore(directory, identity_of(config))
    except OSError as error:
        text = f"{config.robot.urdf}: {error.strerror or error}"
        sink.put(Event(clock.now_ns(), "medium", "CHECKPOINT_REFUSED", text))
        return False
    good, refused = store.read()
    for text in refused:
        sink.put(Event(clock.now_ns(), "medium", "CHECKPOINT_REFUSED", text))
    hold_s = config.service.checkpoint_hold_s
    found = (judge(checkpoint, boot_id(), clock.now_ns(), hold_s) for checkpoint in good)
    return any(daemon.restart(restart) for restart in found)
