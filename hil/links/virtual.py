"""Ports of the flight software in memory, connected to a plant in virtual time."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from itertools import count

from fsw.drivers.wire import (
    FD_BRS,
    FD_FDF,
    ByteChunk,
    CanFrame,
    FrameArray,
    row_of,
    rows_of,
)
from fsw.errors import PortError
from hil.devices.can_segment import TimedFrame
from hil.devices.canopen import SYNC_ID
from hil.devices.plant import Plant
from hil.devices.uart import TimedBytes
from hil.links.clock import SimClock
from hil.world.sensors import generator

FrameTap = Callable[[Sequence[TimedFrame]], Sequence[TimedFrame]]
ByteTap = Callable[[Sequence[TimedBytes]], Sequence[TimedBytes]]
HostTap = Callable[[TimedFrame], Sequence[TimedFrame]]
Stamp = Callable[[int], int]
WAKE_LATENCY_S = 4e-5


def _pass_frames(frames: Sequence[TimedFrame]) -> Sequence[TimedFrame]:
    return frames


def _pass_host(frame: TimedFrame) -> Sequence[TimedFrame]:
    return (frame,)


def _pass_stamp(t_ns: int) -> int:
    return t_ns


def _pass_bytes(chunks: Sequence[TimedBytes]) -> Sequence[TimedBytes]:
    return chunks


class VirtualCan:
    """A CAN port. `tap` may drop, change, delay or add frames on their way to the host.

    `host_tap` may do so with each frame of the host on its way to the nodes. `sent_stamp` gives the
    stamp of a frame of the host from its true time. Within `lost_ns` the port raises PortError, as
    if its device were unplugged.

    A frame's stamp is the time of the read. If the plant produces SYNC or its drives are
    of other makers, the stamp is the frame's end on the bus, as from a kernel, because
    stamps then give the joints' times.
    """

    hands_back = False

    def __init__(self, plant: Plant, clock: SimClock, bus: str, line: int = 0) -> None:
        """Connect the port; `line` 1 is the redundant bus of a pair."""
        self._producer = plant.sync_producer(clock.now_ns())
        self._is_stamped = self._producer is not None or plant.is_foreign(bus)
        self.tap: FrameTap = _pass_frames
        self.outages_ns: list[tuple[int, int]] = []  # [from, to): frames are lost without an error
        self.bus, self.line = bus, line
        self.host_tap: HostTap = _pass_host
        self.sent_stamp: Stamp = _pass_stamp
        self.lost_ns = (0, 0)
        self._plant, self._clock = plant, clock
        self._queue: list[tuple[int, int, TimedFrame]] = []
        self._order = count()
        self._drained: list[bytes] = []

    def _deliver(self, frames: Sequence[TimedFrame]) -> None:
        if not frames or self._is_cut():
            return
        for frame in self.tap(frames):
            heapq.heappush(self._queue, (frame[0], next(self._order), frame))

    def _is_cut(self) -> bool:
        if not self.outages_ns:
            return False
        now_ns = self._clock.now_ns()
        return any(start <= now_ns < stop for start, stop in self.outages_ns)

    def drain(self) -> None:
        """Read the frames that have ended on the bus, for the next `take`."""
        now_ns = self._clock.now_ns()
        self.open()
        self._deliver(self._plant.frames_until(now_ns, self.bus, self.line))
        producer = self._producer
        while producer is not None and producer.next_ns() <= now_ns:
            sync_ns, payload = producer.next_ns(), producer.payload()
            self._deliver([(sync_ns, SYNC_ID, payload, False)])
            self._deliver(self._plant.on_frame(sync_ns, SYNC_ID, payload, self.bus))
        rows = self._drained
        while self._queue and self._queue[0][0] <= now_ns:
            end_ns, word, data, is_fd = heapq.heappop(self._queue)[2]
            stamp_ns = end_ns if self._is_stamped else now_ns
            rows.append(row_of(stamp_ns, word, data, FD_FDF | FD_BRS if is_fd else 0))

    def take(self) -> Callable[[], FrameArray]:
        """Return a function that returns the frames drained since the last call."""
        rows, self._drained = self._drained, []
        return lambda: rows_of(b"".join(rows)).copy()

    def write(self, can_id: int, data: bytes) -> CanFrame:
        """Send a frame, queue the nodes' answers, and return the frame as sent."""
        now_ns = self._clock.now_ns()
        self.open()
        for t_ns, received_id, received, _ in self.host_tap((now_ns, can_id, data, False)):
            self.command(t_ns, received_id, received)
        return CanFrame(self.sent_stamp(now_ns), can_id, data)

    def command(self, t_ns: int, can_id: int, data: bytes) -> None:
        """Deliver a frame of any sender to the nodes at `t_ns`; queue the answers."""
        if not self._is_cut():
            self._deliver(self._plant.on_frame(t_ns, can_id, data, self.bus, self.line))

    def open(self) -> VirtualCan:
        """Return the port. Raises PortError within `lost_ns`."""
        if self.lost_ns[0] <= self._clock.now_ns() < self.lost_ns[1]:
            raise PortError(f"{self.bus}: no such device")
        return self

    def take_dropped(self) -> int:
        """Return 0, because the queue has no bound."""
        return 0

    def inject(self, frame: TimedFrame) -> None:
        """Queue a frame that no node sent, without the tap."""
        heapq.heappush(self._queue, (frame[0], next(self._order), frame))

    def wake_fds(self) -> tuple[int, ...]:
        """Return no descriptor, because frames wait for the tick."""
        return ()

    def close(self) -> None:
        """Discard the queued frames."""
        self._queue.clear()


class VirtualSerial:
    """A serial port. `tap` may drop, change, delay or add chunks on their way to the host."""

    def __init__(self, plant: Plant, clock: SimClock, device: str) -> None:
        self.tap: ByteTap = _pass_bytes
        self.lost_ns = (0, 0)
        self.device = device
        self._plant, self._clock = plant, clock
        self._line = plant.lines[device]
        self._queue: list[tuple[int, int, bytes]] = []
        self._order = count()
        self._descriptor = clock.register(self._next_ns)

    def _next_ns(self) -> int | None:
        due = self._line.next_ns()
        return min(due, self._queue[0][0]) if self._queue else due

    def read(self) -> list[ByteChunk]:
        """Return the chunks that have arrived, stamped with the present time."""
        now_ns = self._clock.now_ns()
        self.open()
        chunks = self._line.take(now_ns)
        for arrival_ns, data in self.tap(chunks) if chunks else ():
            heapq.heappush(self._queue, (arrival_ns, next(self._order), data))
        arrived = []
        while self._queue and self._queue[0][0] <= now_ns:
            arrived.append(ByteChunk(now_ns, heapq.heappop(self._queue)[2]))
        return arrived

    def write(self, data: bytes) -> None:
        """Send bytes to the device."""
        self.open()
        self._plant.write_serial(self._clock.now_ns(), self.device, data)

    def open(self) -> VirtualSerial:
        """Return the port. Raises PortError within `lost_ns`."""
        if self.lost_ns[0] <= self._clock.now_ns() < self.lost_ns[1]:
            raise PortError(f"{self.device}: no such device")
        return self

    def reopen(self) -> VirtualSerial:
        """Return the port without the bytes sent while it was closed."""
        self.open()
        self._line.take(self._clock.now_ns())
        return self

    def wake_fds(self) -> tuple[int, ...]:
        """Return the descriptor that ends the simulated clock's sleep."""
        return (self._descriptor,)

    def close(self) -> None:
        """Discard the queued chunks."""
        self._queue.clear()


class VirtualBench:
    """Clock and ports of one plant in virtual time; the plant must have been powered on at t0."""

    def __init__(
        self, plant: Plant, t0_ns: int, *, seed: int = 0, wake_latency_s: float = WAKE_LATENCY_S
    ) -> None:
        self.plant = plant
        self.clock = SimClock(t0_ns, generator(seed, "host"), wake_latency_s)
        self.cans = {name: VirtualCan(plant, self.clock, name) for name in plant.segments}
        self.can = next(iter(self.cans.values()))
        self.redundant = VirtualCan(plant, self.clock, self.can.bus, line=1)
        if plant.is_free:  # no SYNC starts the truth
            plant.clock.start(t0_ns)
        self.serials = {name: VirtualSerial(plant, self.clock, name) for name in plant.lines}
        self.imu = self.serials.get("imu")
        self.star_tracker = self.serials.get("star_tracker")
