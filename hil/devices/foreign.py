"""One bus of drives that speak a dialect: when they measure, and when their frames end."""

import heapq
from collections.abc import Mapping
from typing import Protocol

from hil.devices.can_segment import TimedFrame, duration_ns
from hil.devices.canopen import SYNC_ID, JointNode
from hil.devices.dialects import EXTENDED, Dialect, Frame, Measured
from hil.world.sensors import generator

CLOCK_PPM = 50.0  # 1 sigma of the errors of clocks and timers
LATE_NS = 20_000.0  # mean lateness of the other master's commands
TURN_NS = 600_000.0  # between its commands to two drives
EXTENDED_NS = 20_000.0  # more time on the bus of an identifier of 29 bits


class Measure(Protocol):
    """Measures one joint at one instant."""

    def __call__(self, joint: int, t_ns: float) -> tuple[float, float, float]:
        """Return position [rad], speed [rad/s] and torque [N m] as the drive reports them."""
        ...


class ForeignSegment:
    """Drives of a dialect. Frames wait until the line is free."""

    def __init__(
        self,
        name: str,
        dialect: Dialect,
        numbers: Mapping[int, int],
        measure: Measure,
        seed: int,
        *,
        index: int,
        rate_hz: float,
        t0_ns: int,
    ) -> None:
        """`numbers`: the drive's number of each joint."""
        self.name, self.dialect = name, dialect
        self.nodes: dict[int, JointNode] = {}  # none of the tailored ones
        self._numbers, self._measure, self._t0_ns = numbers, measure, t0_ns
        self._rng = generator(seed, "cyclic", index)
        self._rates = {joint: 1.0 + CLOCK_PPM * 1e-6 * self._rng.normal() for joint in numbers}
        period_ns, first = 1e9 / rate_hz, next(iter(numbers))
        self._periods_ns = {
            joint: period_ns * self._rates[first if dialect.trigger == "command" else joint]
            for joint in numbers
        }
        self._due: list[tuple[float, int]] = []
        if dialect.trigger == "timer":
            self._due = [(t0_ns + self._rng.random() * period_ns, joint) for joint in numbers]
        elif dialect.trigger == "command":
            self._due = [(t0_ns + k * TURN_NS, joint) for k, joint in enumerate(numbers)]
        heapq.heapify(self._due)
        self._waiting: list[tuple[float, int, Frame, int]] = []  # ready, word, joint commanded
        self._free_ns = float(t0_ns)

    def on_frame(self, t_ns: int, can_id: int, data: bytes, line: int = 0) -> list[TimedFrame]:  # noqa: ARG002
        """Accept a frame of the host: a SYNC without data; return what was sent before it."""
        sent = self.frames_until(t_ns)
        if self.dialect.trigger == "sync" and can_id == SYNC_ID and not data:
            self._free_ns = max(self._free_ns, t_ns + duration_ns(0, False, 4.0))
            for joint in self._numbers:
                self._send(joint, t_ns, self._free_ns)
        return sent

    def frames_until(self, t_ns: int, line: int = 0) -> list[TimedFrame]:  # noqa: ARG002
        """Return the frames whose sending begins by this time, with their ends on the bus."""
        while self._due and self._due[0][0] <= t_ns:
            at_ns, joint = self._due[0]
            heapq.heapreplace(self._due, (at_ns + self._periods_ns[joint], joint))
            if self.dialect.command is None:
                self._send(joint, at_ns, at_ns)
            else:
                command = self.dialect.command(self._numbers[joint])
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
                self._send(joint, self._free_ns, self._free_ns)
        return sent

    def _send(self, joint: int, at_ns: float, from_ns: float) -> None:
        """Measure a joint; its frames are ready some time after `from_ns`."""
        clock_us = round((at_ns - self._t0_ns) * 1e-3 / self._rates[joint])
        measured = Measured(*self._measure(joint, at_ns), clock_us)
        for frame in self.dialect.encode(self._numbers[joint], measured):
            self._wait(from_ns + frame.after_ns, frame, -1)

    def _wait(self, ready_ns: float, frame: Frame, joint: int) -> None:
        heapq.heappush(self._waiting, (ready_ns, frame.word, frame, joint))
