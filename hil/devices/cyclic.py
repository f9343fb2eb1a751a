"""Joint drives that report by timers of their own: two frames each, no SYNC, no counter, no time.

The layout is that of a widespread open drive: identifiers `axis << 5 | command`, command 0x09 with
position [rev] and speed [rev/s], 0x1C with a target and the estimate of the torque [N m], all
little-endian floats of 32 bits.
"""

import heapq
import math
import struct
from collections.abc import Mapping
from typing import Protocol

from hil.devices.can_segment import TimedFrame, duration_ns
from hil.devices.canopen import JointNode
from hil.world.sensors import generator

ENCODER, TORQUES = 0x09, 0x1C
RESPONSE_NS = 30_000.0  # measurement to the first frame ready
GAP_NS = 40_000.0  # between the two frames of a drive
CLOCK_PPM = 50.0  # 1 sigma of the timers' errors
_FLOATS = struct.Struct("<ff")


class Measure(Protocol):
    """Measures one joint at one instant."""

    def __call__(self, joint: int, t_ns: float) -> tuple[float, float, float]:
        """Return position [rad], speed [rad/s] and torque [N m] as the drive reports them."""
        ...


class CyclicSegment:
    """One bus of such drives; it answers nothing. Frames wait until the line is free."""

    def __init__(
        self,
        name: str,
        axes: Mapping[int, int],
        measure: Measure,
        seed: int,
        *,
        index: int,
        rate_hz: float,
        t0_ns: int,
    ) -> None:
        """`axes`: axis number of each joint."""
        self.name = name
        self.nodes: dict[int, JointNode] = {}  # none that listens
        self._axes, self._measure = axes, measure
        self._rng = generator(seed, "cyclic", index)
        self._periods_ns = {
            joint: 1e9 / rate_hz * (1.0 + CLOCK_PPM * 1e-6 * float(self._rng.standard_normal()))
            for joint in axes
        }
        self._due = [
            (t0_ns + float(self._rng.random()) * period_ns, joint)
            for joint, period_ns in self._periods_ns.items()
        ]
        heapq.heapify(self._due)
        self._waiting: list[tuple[float, int, bytes]] = []  # ready, identifier, data
        self._free_ns = float(t0_ns)

    def on_frame(self, t_ns: int, can_id: int, data: bytes, line: int = 0) -> list[TimedFrame]:  # noqa: ARG002
        """Ignore a frame of the host."""
        return []

    def frames_until(self, t_ns: int, line: int = 0) -> list[TimedFrame]:  # noqa: ARG002
        """Return the frames whose sending begins by this time, with their ends on the bus."""
        while self._due and self._due[0][0] <= t_ns:
            at_ns, joint = self._due[0]
            heapq.heapreplace(self._due, (at_ns + self._periods_ns[joint], joint))
            position_rad, speed_rad_s, torque_nm = self._measure(joint, at_ns)
            axis, ready_ns = self._axes[joint] << 5, at_ns + RESPONSE_NS
            turns = _FLOATS.pack(position_rad / math.tau, speed_rad_s / math.tau)
            heapq.heappush(self._waiting, (ready_ns, axis | ENCODER, turns))
            torques = _FLOATS.pack(0.0, torque_nm)
            heapq.heappush(self._waiting, (ready_ns + GAP_NS, axis | TORQUES, torques))
        sent: list[TimedFrame] = []
        while self._waiting and max(self._waiting[0][0], self._free_ns) <= t_ns:
            ready_ns, can_id, data = heapq.heappop(self._waiting)
            stuff_bits = float(self._rng.random()) * (34 + 8 * len(data)) / 8.0
            self._free_ns = max(ready_ns, self._free_ns) + duration_ns(len(data), False, stuff_bits)
            sent.append((round(self._free_ns), can_id, data, False))
        return sent
