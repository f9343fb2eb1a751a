"""One CAN bus of joint nodes: what they answer, and when each frame ends on the bus."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from hil.devices import canopen
from hil.devices.canopen import JointNode, NodeState, Reading
from hil.sensors import generator

TimedFrame = tuple[int, int, bytes, bool]  # end on the bus [ns], identifier, data, is CAN FD
RESPONSE_NS = 30_000.0  # SYNC received to PDO ready
RESPONSE_JITTER_NS = 20_000.0
MOTOR_TEMPERATURE_DEGC = 25.0


class Latch(Protocol):
    """Measures every joint of the robot at one instant."""

    def __call__(self, t_ns: int) -> Sequence[Reading]:
        """Return one reading per joint of the robot."""
        ...


def duration_ns(length: int, is_fd: bool, stuff_bits: float) -> float:
    """Return how long a frame with `length` data bytes holds the bus, interframe space included.

    Classic at 1 Mbit/s; FD 1 Mbit/s arbitration and 5 Mbit/s data (ISO, bit-rate switch).
    """
    if is_fd:
        return 30e3 + 200.0 * (8 * length + 35) + 200.0 * stuff_bits
    return 1e3 * (47 + 8 * length + stuff_bits)


class SyncProducer:
    """Another node of the bus that produces SYNC, where the host only consumes it."""

    def __init__(self, rate_hz: float, counter_max: int, t0_ns: int) -> None:
        self._period_ns = 1e9 / rate_hz
        self._max = counter_max
        self._t0_ns = t0_ns
        self._sent = 0

    def next_ns(self) -> int:
        """Return when the next SYNC is due."""
        return self._t0_ns + round((self._sent + 1) * self._period_ns)

    def payload(self) -> bytes:
        """Return the counter byte of the SYNC now due, and count it as sent."""
        self._sent += 1
        return bytes([(self._sent - 1) % self._max + 1])


class CanSegment:
    """Nodes of one bus. Frames queue by identifier behind whatever holds the bus."""

    def __init__(
        self,
        name: str,
        nodes: dict[int, JointNode],
        latch: Latch,
        seed: int,
        *,
        index: int,
        heartbeat_s: float,
        torque_range_nm: float,
        t0_ns: int,
    ) -> None:
        self.name = name
        self.nodes = nodes  # by joint index in the robot
        self._latch = latch
        self._range_nm = torque_range_nm
        self._rng = generator(seed, "bus", index)
        self._stuffing = np.empty(0)
        self._next_draw = 0
        self._t0_ns = t0_ns
        self._busy_ns = float(t0_ns)
        period = heartbeat_s * 1e9
        self._period_ns = period
        # boot-up frames at power-on, then heartbeats spread over the period
        self._booting = list(nodes.values())
        self._heartbeat_ns = {
            joint: t0_ns + period * (1.0 + i / len(nodes)) for i, joint in enumerate(nodes)
        }

    def _uniform(self) -> float:
        if self._next_draw >= len(self._stuffing):
            self._stuffing = self._rng.random(1024)
            self._next_draw = 0
        self._next_draw += 1
        return float(self._stuffing[self._next_draw - 1])

    def _place(self, ready_ns: float, can_id: int, data: bytes, is_fd: bool) -> TimedFrame:
        """Put one frame on the bus as soon as it is ready and the bus is free."""
        length = len(data)
        stuff_bits = self._uniform() * (34 + 8 * length) / 8.0
        self._busy_ns = max(ready_ns, self._busy_ns) + duration_ns(length, is_fd, stuff_bits)
        return round(self._busy_ns), can_id, data, is_fd

    def on_frame(self, t_ns: int, can_id: int, data: bytes) -> list[TimedFrame]:
        """Take a frame of the host and return what the nodes answer, in bus order."""
        if can_id == canopen.SYNC_ID and len(data) == 1:
            return self._on_sync(t_ns, data[0])
        if can_id == canopen.NMT_ID and len(data) == 2:
            restarted = [n for n in self.nodes.values() if n.on_nmt(data[0], data[1])]
            return [self._place(t_ns + 1e6, *self._state_of(n, boot=True)) for n in restarted]
        if 0x600 < can_id < 0x680:
            for node in self.nodes.values():
                reply = node.on_sdo(data) if node.node_id == can_id - 0x600 else None
                if reply is not None:
                    return [self._place(t_ns + 5e5, 0x580 + node.node_id, reply, False)]
        return []

    def _on_sync(self, t_ns: int, counter: int) -> list[TimedFrame]:
        readings = self._latch(t_ns)
        t_us = (t_ns - self._t0_ns) // 1000
        frames: list[tuple[int, bytes, bool]] = []
        for joint, node in self.nodes.items():
            reading = readings[joint]
            status = canopen.STATUS_GOOD
            if abs(reading.torque_nm) > self._range_nm:
                status |= canopen.STATUS_OVERLOAD
            pdos = node.on_sync(counter, reading, t_us, status)
            frames += [(can_id, data, node.is_fd) for can_id, data in pdos.items()]
        frames.sort()
        sync_end = t_ns + duration_ns(1, False, 4.0)
        ready_ns = sync_end + RESPONSE_NS + RESPONSE_JITTER_NS * self._uniform()
        return [self._place(ready_ns, *frame) for frame in frames]

    @staticmethod
    def _state_of(node: JointNode, *, boot: bool = False) -> tuple[int, bytes, bool]:
        state = NodeState.BOOT_UP if boot else node.state
        return 0x700 + node.node_id, bytes([state]), False

    def frames_until(self, t_ns: int) -> list[TimedFrame]:
        """Return what nodes said unasked: boot-up frames, heartbeats."""
        frames = [self._place(self._t0_ns, *self._state_of(n, boot=True)) for n in self._booting]
        self._booting = []
        for joint, node in self.nodes.items():
            while self._heartbeat_ns[joint] <= t_ns:
                if not node.silent:
                    frames.append(self._place(self._heartbeat_ns[joint], *self._state_of(node)))
                self._heartbeat_ns[joint] += self._period_ns
        return frames

    def emergency(self, t_ns: int, joint: int, code: int, register: int) -> TimedFrame:
        """Return an EMCY frame of the joint's node."""
        data = canopen.encode_emergency(code, register)
        return self._place(t_ns, canopen.SYNC_ID + self.nodes[joint].node_id, data, False)
