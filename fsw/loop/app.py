"""The loop process on the machine's clock and devices, until SIGTERM, SIGINT or SIGHUP."""

import os
import signal
from collections.abc import Callable, Sequence
from functools import partial
from types import FrameType
from typing import TypeVar

from fsw.clock import Clock, MonotonicClock
from fsw.config import Config
from fsw.drivers.wire import BytePort, FramePort
from fsw.errors import PortError
from fsw.exchange.sinks import IMU, STAR_TRACKER, Sink
from fsw.loop.notify import Notifier
from fsw.loop.ports import SECOND, Ports
from fsw.loop.processes import Processes, lock_state
from fsw.loop.state_guard import StateGuard, close_to_others
from fsw.loop.wiring import build
from fsw.messages import Event
from fsw.scheduler import realtime
from fsw.scheduler.tasks import is_due

WATCHES_PER_S = 10  # looks at the other processes
RESTART_EXIT = 75  # exit code: the caller must start the daemon again
SERVICE_WAIT_S = 20.0  # for the service to write its remaining data
SETTLE_WAIT_S = 20  # for the estimation to process its remaining traffic
P = TypeVar("P", FramePort, BytePort)


class StopSignal:
    """Records whether SIGTERM, SIGINT or SIGHUP was received; `nohup` keeps the last ignored."""

    def __init__(self) -> None:
        self.received = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._receive)
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
            signal.signal(signal.SIGHUP, self._receive)

    def _receive(self, _number: int, _frame: FrameType | None) -> None:
        self.received = True


def open_ports(config: Config, clock: Clock, sink: Sink) -> Ports:
    """Open every configured port; a port that fails counts as lost and is reported as an event."""
    from fsw.drivers.ports.can_bus import open_can
    from fsw.drivers.ports.feed_socket import open_feed
    from fsw.drivers.ports.serial_line import open_serial

    def attempt(name: str, opener: Callable[[], P]) -> P | None:
        try:
            return opener()
        except PortError as error:
            sink.put(Event(clock.now_ns(), "high", "PORT_LOST", f"{name}: {error}"))
            return None

    cans: dict[str, Callable[[], FramePort]] = {}
    lines: dict[str, Callable[[], BytePort]] = {}
    for bus in config.buses:
        if bus.feed is not None:
            lines[bus.name] = partial(open_feed, config.feed_place(bus), clock)
            continue
        cans[bus.name] = partial(open_can, bus, clock)
        second = bus.second()
        if second is not None:
            cans[bus.name + SECOND] = partial(open_can, second, clock)
    imu, tracker = config.imu, config.star_tracker
    if imu.present and imu.bus is None:
        lines[IMU] = partial(open_serial, config.device(imu.port), imu.baud_rate, clock)
    if tracker is not None and tracker.bus is None:
        path = config.device(tracker.port)
        lines[STAR_TRACKER] = partial(open_serial, path, tracker.baud_rate, clock)
    opened = {name: attempt(name, opener) for name, opener in lines.items()}
    return Ports(
        can={name: attempt(f"can/{name}", opener) for name, opener in cans.items()},
        imu=opened.get(IMU),
        star_tracker=opened.get(STAR_TRACKER),
        feeds={bus.name: opened[bus.name] for bus in config.buses if bus.feed is not None},
        can_openers=cans,
        line_openers=lines,
    )


def run_live(config: Config, *, cold: bool = False) -> int:
    """Run the daemon until it is stopped; return its exit code. `cold` ignores checkpoints.

    The code is RESTART_EXIT after a RESTART command; otherwise 0, or 1 if the service did not end
    in order, or if a process was given up at the end.

    Raises
    ------
    PortError when another daemon runs on the same state directory.
    """
    stop, notifier = StopSignal(), Notifier(os.environ)
    clock = MonotonicClock()
    state = config.resolve(config.service.state_directory)
    close_to_others(state)
    guard = StateGuard(state, lock_state(state, clock))
    if config.telemetry is not None:
        from fsw.telemetry.tables.effective import (
            effective_config,  # only telemetry can change the configuration
        )

        config = effective_config(config)
    processes = Processes(config, clock, clock.now_ns() if cold else 0, guard.say)
    sink = processes.sink
    sink.put(Event(clock.now_ns(), "info", "STARTED", f"process {os.getpid()}"))
    ports = open_ports(config, clock, sink)
    more = partial(_process_values, processes)
    loop = build(config, clock, ports, sink, processes.deadline_ns, more)
    for text in realtime.prepare(config.scheduler.cpu, config.scheduler.realtime_priority):
        sink.put(Event(clock.now_ns(), "low", "REALTIME", text))
    if config.scheduler.idle_latency_us is not None:
        try:
            realtime.keep_awake(config.scheduler.idle_latency_us)
        except OSError as error:
            text = f"scheduler.idle_latency_us: {error}"
            sink.put(Event(clock.now_ns(), "low", "REALTIME", text))
    realtime.freeze_garbage()
    ticks_per_s = max(1, round(config.scheduler.tick_rate_hz))
    notifier.send("READY=1")

    def turn() -> int:
        index = loop.step().index
        for command in processes.commands():
            processes.submit(command, loop)
        return index

    def each_second() -> None:
        realtime.collect_young()
        for code, text in guard.faults():
            sink.put(Event(clock.now_ns(), "high", code, text))
        processes.report_lost()
        if processes.watch():
            notifier.send("WATCHDOG=1")

    duties = (
        (max(1, ticks_per_s // WATCHES_PER_S), processes.watch),  # notices an end at once
        (ticks_per_s, each_second),
    )
    drive(turn, duties, lambda: stop.received or loop.stop_requested)
    notifier.send("STOPPING=1")
    loop.finish()
    processes.settle(SETTLE_WAIT_S, loop.report)
    loop.close()
    ended = processes.service.wait(SERVICE_WAIT_S)
    guard.close()
    if loop.restart_requested:
        return RESTART_EXIT
    return 0 if ended and not processes.gave_up else 1


def _process_values(processes: Processes) -> dict[str, object]:
    """Return the state of the other processes for the status."""
    return {"processes": processes.summary()}


def drive(
    turn: Callable[[], int],
    duties: Sequence[tuple[int, Callable[[], object]]],
    ended: Callable[[], bool],
) -> None:
    """Run ticks, and the duties that come due, until `ended`.

    Parameters
    ----------
    turn : runs one tick and returns the tick's index on the grid
    duties : period [ticks] and action of each; slipped ticks count too, but a duty runs at most
        once per tick run
    ended : returns True after the last tick
    """
    index = 0
    while not ended():
        before, index = index, turn()
        for ticks, action in duties:
            if is_due(ticks, index, before):
                action()
