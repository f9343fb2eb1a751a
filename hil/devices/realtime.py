"""The plant in real time: python-can buses and pseudo-terminals, one thread, absolute deadlines."""

import ctypes
import gc
import json
import math
import os
import select
import signal
import sys
import termios
import time
import tty
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can

from hil.devices.can_segment import TimedFrame
from hil.devices.canopen import SYNC_ID
from hil.devices.feed_link import FeedEnd
from hil.devices.frame_port import FramePort
from hil.devices.multicast import MulticastPort
from hil.devices.plant import Plant
from hil.devices.plant_file import BusLink, PlantFile, Realtime, build, load

PR_SET_TIMERSLACK = 29
IDLE_NS = 50_000_000
AHEAD_NS = 100_000  # bytes are prepared so long before their time; the rest is a busy wait
HANG_UP_NS = 1_000_000_000
STALL_NS = 2_000_000  # an action later than this was delayed by this process, not by a device
COMPARED_NS = 20_000_000  # time between two comparisons of the clocks
MOST_STALLS = 10_000  # most stalls that are reported


def monotonic_less_realtime_ns() -> int:
    """Return CLOCK_MONOTONIC minus CLOCK_REALTIME [ns], for conversion of kernel stamps.

    The result is from the comparison, of three, with the shortest time between its readings.
    """
    readings = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(3)]
    before_ns, realtime_ns, after_ns = min(readings, key=lambda reading: reading[2] - reading[0])
    return (before_ns + after_ns) // 2 - realtime_ns


class Stalls:
    """Intervals in which this process was late by more than any device would be."""

    def __init__(self) -> None:
        self.found: list[tuple[int, int]] = []  # due time and actual time of an action [ns]

    def note(self, due_ns: int, now_ns: int) -> None:
        """Record a stall if a due action came late; overlapping stalls become one."""
        if now_ns - due_ns < STALL_NS:
            return
        if self.found and due_ns <= self.found[-1][1]:
            due_ns = min(self.found.pop()[0], due_ns)
        if len(self.found) < MOST_STALLS:
            self.found.append((due_ns, now_ns))


class BusEnd:
    """One bus and the frames that wait to be sent on this bus."""

    def __init__(self, link: BusLink, plant: Plant, stalls: Stalls, line: int = 0) -> None:
        """Open the bus; `line` 1 is the redundant bus of a pair."""
        self._stalls = stalls
        is_multicast = link.interface == "udp_multicast"
        self._port = MulticastPort(link) if is_multicast else FramePort(link)
        self._plant, self._name, self._line = plant, link.name, line
        self._producer = plant.sync_producer(time.monotonic_ns())
        self._queue: deque[TimedFrame] = deque()  # in order of time
        self._compared_ns, self._offset_ns = -COMPARED_NS, 0
        self.sync_seen = False
        self.send_errors = 0

    @property
    def receive_errors(self) -> int:
        """Number of failed receptions."""
        return self._port.receive_errors

    def fileno(self) -> int:
        """Return the descriptor that is readable when frames wait."""
        return self._port.fileno()

    def receive(self) -> None:
        """Read all frames and queue the answers. A SYNC is latched at its kernel stamp."""
        now_ns = time.monotonic_ns()
        if now_ns - self._compared_ns > COMPARED_NS:
            self._compared_ns, self._offset_ns = now_ns, monotonic_less_realtime_ns()
        for stamp_ns, can_id, data in self._port.receive():
            if can_id == SYNC_ID and self._producer is not None:
                continue
            t_ns = stamp_ns + self._offset_ns
            if self.sync_seen:
                self._stalls.note(t_ns, now_ns)
            self.sync_seen |= can_id == SYNC_ID
            self._queue += self._plant.on_frame(t_ns, can_id, data, self._name, self._line)

    def send_due(self, now_ns: int) -> None:
        """Send frames that have ended on the simulated bus, and SYNC if the plant produces it."""
        producer = self._producer
        while producer is not None and producer.next_ns() <= now_ns:
            payload = producer.payload()
            self.send_errors += self._port.send([(now_ns, SYNC_ID, payload, False)])
            self.sync_seen = True
            stamp_ns = time.monotonic_ns()
            self._queue += self._plant.on_frame(stamp_ns, SYNC_ID, payload, self._name)
        self._queue += self._plant.frames_until(now_ns, self._name, self._line)
        due = []
        while self._queue and self._queue[0][0] <= now_ns:
            due.append(self._queue.popleft())
        if due:
            self.send_errors += self._port.send(due)

    def deadline_ns(self) -> int | None:
        """Return the wake-up time [ns], or None. One wake-up sends all answers to one SYNC."""
        due = [self._queue[-1][0]] if self._queue else []
        if (next_ns := self._plant.next_frame_ns(self._name)) < math.inf:
            due.append(round(next_ns))
        if self._producer is not None:
            due.append(self._producer.next_ns())
        return min(due, default=None)

    def close(self) -> None:
        """Release the bus."""
        self._port.close()


class PtyEnd:
    """A pseudo-terminal with a link at `path`; it stays open so that the host can reopen it."""

    def __init__(self, device: str, path: Path, plant: Plant) -> None:
        self.device, self.path = device, path
        self._plant = plant
        self.dropped_bytes = 0
        self._back_ns: int | None = None  # end of a hang-up; None: not hung up
        path.parent.mkdir(parents=True, exist_ok=True)
        self._open()

    def _open(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave, termios.TCSANOW)
        os.set_blocking(self._master, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._slave))

    @property
    def is_up(self) -> bool:
        """Whether the terminal exists."""
        return self._back_ns is None

    def hang_up(self, back_ns: int) -> None:
        """Remove the terminal until `back_ns`, like an unplugged USB converter."""
        if self._back_ns is None:
            self.close()
        self._back_ns = back_ns

    def follow(self, now_ns: int) -> None:
        """Make a new terminal if the hang-up is over."""
        if self._back_ns is not None and now_ns >= self._back_ns:
            self._back_ns = None
            self._open()

    def fileno(self) -> int:
        """Return the descriptor that is readable when the host has written."""
        return self._master

    def receive(self) -> None:
        """Deliver bytes of the host to the device."""
        self._plant.write_serial(time.monotonic_ns(), self.device, os.read(self._master, 4096))

    def send(self, data: bytes) -> None:
        """Write bytes to the host; bytes that do not fit in the host's buffer are lost."""
        if not self.is_up:
            return
        try:
            written = os.write(self._master, data)
        except BlockingIOError:
            written = 0
        self.dropped_bytes += len(data) - written

    def close(self) -> None:
        """Close both ends and remove the link."""
        self.path.unlink(missing_ok=True)
        os.close(self._master)
        os.close(self._slave)


def prepare(realtime: Realtime) -> dict[str, Any]:
    """Request priority, CPU and fine timers; return which were granted."""
    granted: dict[str, Any] = {"fifo": False}
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)
    if realtime.cpu is not None:
        os.sched_setaffinity(0, {realtime.cpu})
    if realtime.priority > 0:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(realtime.priority))
            granted["fifo"] = True
        except PermissionError as error:
            granted["refused"] = str(error)
    return granted


def serve(
    plant: Plant,
    buses: list[BusEnd],
    ptys: list[PtyEnd],
    feeds: list[FeedEnd],
    stopping: Callable[[], bool],
    hang_ups: list[int],
    heard: list[int],
    stalls: Stalls,
) -> None:
    """Answer and transmit until `stopping()`; hang up the first terminal if `hang_ups` is set.

    Serial bytes are discarded until the host reads. It does from the first SYNC on, from the first
    received datagram of a feed, or, where drives wait for no SYNC, once `heard` is not empty.
    """
    by_device: dict[str, PtyEnd | FeedEnd] = {feed.device: feed for feed in feeds}
    by_device |= {pty.device: pty for pty in ptys}
    while not stopping():
        now_ns = time.monotonic_ns()
        due = [t for bus in buses if (t := bus.deadline_ns()) is not None]
        serial_ns = plant.next_serial_ns()
        if serial_ns is not None:
            due.append(serial_ns - AHEAD_NS)
        due_ns = min([now_ns + IDLE_NS, *due])
        if hang_ups:
            hang_ups.clear()
            ptys[0].hang_up(now_ns + HANG_UP_NS)
        ends: list[BusEnd | PtyEnd] = [*buses, *(pty for pty in ptys if pty.is_up)]
        readable, _, _ = select.select(ends, (), (), max(0, due_ns - now_ns) * 1e-9)
        for end in readable:
            end.receive()
        now_ns = time.monotonic_ns()
        if any(bus.sync_seen for bus in buses):
            stalls.note(due_ns, now_ns)
        for bus in buses:
            bus.send_due(now_ns)
        for pty in ptys:
            pty.follow(now_ns)
        if any(feed.is_received for feed in feeds) or (heard and plant.is_free):
            plant.clock.start(now_ns)
        listening = any(bus.sync_seen for bus in buses) or plant.clock.origin_ns is not None
        ready = plant.serial_until(now_ns + AHEAD_NS)
        timed = [(t, device, data) for device, chunks in ready.items() for t, data in chunks]
        for at_ns, device, data in sorted(timed):
            if device in by_device and (listening or device in plant.feeds):
                while now_ns < at_ns:
                    now_ns = time.monotonic_ns()
                by_device[device].send(data)


def _say(line: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


def _open(
    file: PlantFile, folder: Path, plant: Plant, stalls: Stalls
) -> tuple[list[BusEnd], list[PtyEnd], list[FeedEnd]]:
    paths = {"imu": file.links.imu, "star_tracker": file.links.star_tracker}
    buses = [
        BusEnd(link, plant, stalls, line)
        for pair in file.links.buses
        for line, link in enumerate(pair.lines())
    ]
    ptys = [
        PtyEnd(device, folder / path, plant)
        for device, path in paths.items()
        if path is not None and device in plant.lines
    ]
    link = file.links.feed
    feeds = [] if link is None else [FeedEnd(name, link.host, link.port) for name in plant.feeds]
    return buses, ptys, feeds


def run(path: Path) -> int:
    """Run the plant of a file; print one JSON line when ready and one at the end."""
    try:
        file = load(path)
        folder = path.absolute().parent
        plant = build(file, folder, time.monotonic_ns())
        stalls = Stalls()
        buses, ptys, feeds = _open(file, folder, plant, stalls)
    except (ValueError, OSError, can.CanError) as error:
        sys.stderr.write(f"{path}: {error}\n")
        return 2
    stop: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda signum, _frame: stop.append(signum))
    hang_ups: list[int] = []
    signal.signal(signal.SIGUSR1, lambda signum, _frame: hang_ups.append(signum))
    heard: list[int] = []
    signal.signal(signal.SIGUSR2, lambda signum, _frame: heard.append(signum))
    granted = prepare(file.realtime)
    gc.collect()
    gc.freeze()
    gc.disable()
    _say({"ready": True, "pid": os.getpid(), **granted, **{p.device: str(p.path) for p in ptys}})
    try:
        serve(plant, buses, ptys, feeds, lambda: bool(stop), hang_ups, heard, stalls)
    finally:
        for bus in buses:
            bus.close()
        for feed in feeds:
            feed.close()
        for pty in ptys:
            if pty.is_up:
                pty.close()
    dropped = {pty.device: pty.dropped_bytes for pty in ptys}
    dropped |= {feed.device: feed.dropped_bytes for feed in feeds}
    errors = sum(bus.send_errors for bus in buses)
    ended = {"dropped_bytes": dropped, "send_errors": errors, "stalls_ns": stalls.found}
    _say({"stopped": True, **ended, **plant.times()})
    return 0
