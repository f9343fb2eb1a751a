"""One bus of drives of other makers: when they measure, and when their frames end."""

import heapq
import math
from collections.abc import Mapping
from typing import Protocol

from hil.devices.can_segment import TimedFrame, duration_ns
from hil.devices.canopen import SYNC_ID, JointNode
from hil.devices.dialects import EXTENDED, Drive, Frame, Measured
from hil.world.sensors import generator

CLOCK_PPM = 50.0  # 1 sigma of the errors of clocks and timers
LATE_NS = 20_000.0  # mean lateness of the other master's commands
TURN_NS = 600_000.0  # between its commands to two drives
EXTENDED_NS = 20_000.0  # additional time on the bus for an identifier of 29 bits


class Measure(Protocol):
    """Measures one joint at one instant."""

    def __call__(self, joint: int, t_ns: float) -> tuple[float, float, float]:
        """Return position [rad], speed [rad/s] and torque [N m] as the drive reports them."""
        ...


class ForeignSegment:
    """Drives of other makers. Frames wait until the line is free.

    Parameters
    ----------
    drives : by the joints of each drive
    numbers : number of its drive, by joint
    measure : what the drive of a joint reports at a time
    t0_ns : start [ns] on the bench's clock
    sync_bytes : length of the data of SYNC
    """

    def __init__(
        self,
        name: str,
        drives: Mapping[tuple[int, ...], Drive],
        numbers: Mapping[int, int],
        measure: Measure,
        seed: int,
        *,
        index: int,
        rate_hz: float,
        t0_ns: int,
        sync_bytes: int = 0,
    ) -> None:
        self.name = name
        self.nodes: dict[int, JointNode] = {}  # no tailored nodes here
        self.is_free = any(drive.trigger != "sync" for drive in drives.values())
        self._drives = {joints[0]: (joints, drive) for joints, drive in drives.items()}
        self._numbers, self._measure, self._t0_ns = numbers, measure, t0_ns
        self._sync_bytes = sync_bytes
        self._rng = generator(seed, "cyclic", index)
        rates = {joint: 1.0 + CLOCK_PPM * 1e-6 * self._rng.normal() for joint in numbers}
        self._rates = rates
        period_ns, first = 1e9 / rate_hz, next(iter(numbers))
        by = {joint: drive.trigger for joint, (_, drive) in self._drives.items()}
        self._periods_ns = {
            joint: period_ns * rates[first if trigger == "command" else joint]
            for joint, trigger in by.items()
        }
        self._due = [  # time, first joint of the drive
            (t0_ns + self._rng.random() * period_ns, joint)
            for joint, trigger in by.items()
            if trigger == "timer"
        ]
        asked = [joint for joint, trigger in by.items() if trigger == "command"]
        self._due += [(t0_ns + k * TURN_NS, joint) for k, joint in enumerate(asked)]
        heapq.heapify(self._due)
        self._waiting: list[tuple[float, int, Frame, int]] = []  # ready, word, joint commanded
        self._free_ns = float(t0_ns)

    def next_ns(self) -> float:
        """Return when the next drive measures or the next frame begins [ns]; infinite: never."""
        begins = max(self._waiting[0][0], self._free_ns) if self._waiting else math.inf
        return min(begins, self._due[0][0] if self._due else math.inf)

    def on_frame(self, t_ns: int, can_id: int, data: bytes, line: int = 0) -> list[TimedFrame]:  # noqa: ARG002
        """Accept a frame of the host, which may be a SYNC; return what was sent before it."""
        sent = self.frames_until(t_ns)
        if can_id == SYNC_ID and len(data) == self._sync_bytes:
            self._free_ns = max(self._free_ns, t_ns + duration_ns(len(data), False, 4.0))
            for joint, (_, drive) in self._drives.items():
                if drive.trigger == "sync":
                    at_ns = t_ns + drive.latch_ns
                    self._send(joint, at_ns, self._free_ns, data[0] if data else 0)
        return sent

    def frames_until(self, t_ns: int, line: int = 0) -> list[TimedFrame]:  # noqa: ARG002
        """Return the frames whose sending begins by this time, with their ends on the bus."""
        while self._due and self._due[0][0] <= t_ns:
            at_ns, joint = self._due[0]
            heapq.heapreplace(self._due, (at_ns + self._periods_ns[joint], joint))
            asks = self._drives[joint][1].command
            if asks is None:
                self._send(joint, at_ns, at_ns)
            else:
                command = asks(self._numbers[joint])
                self._wait(at_ns + LATE_NS * self._rng.exponential(), command, joint)
        sent: list[TimedFrame] = []
        while self._waiting and max(self._waiting[0][0], self._free_ns) <= t_ns:
            ready_ns, _, frame, joint = heapq.heappop(self._waiting)
            stuff_bits = self._rng.random() * (34 + 8 * len(frame.data)) / 8.0
            self._free_ns = max(ready_ns, self._free_ns)
            self._free_ns += duration_ns(len(frame.data), frame.is_fd, stuff_bits)
            self._free_ns += EXTENDED_NS * bool(frame.word & EXTENDED)
            sent.append((round(self._free_ns), frame.word, frame.data, frame.is_fd))
            if joint >= 0:
                at_ns = self._free_ns + self._drives[joint][1].latch_ns
                self._send(joint, at_ns, self._free_ns)
        return sent

    def _send(self, joint: int, at_ns: float, from_ns: float, counter: int = 0) -> None:
        """Measure the joints of a drive; its frames are ready some time after `from_ns`."""
        clock_us = round((at_ns - self._t0_ns) * 1e-3 / self._rates[joint])
        joints, drive = self._drives[joint]
        own = [Measured(*self._measure(k, at_ns), clock_us, counter) for k in joints]
        for frame in drive.encode(self._numbers[joint], *own):
            self._wait(from_ns + frame.after_ns, frame, -1)

    def _wait(self, ready_ns: float, frame: Frame, joint: int) -> None:
        heapq.heappush(self._waiting, (ready_ns, frame.word, frame, joint))
