"""One CAN bus of joint nodes: the nodes' answers, and the time when each frame ends."""

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from hil.devices import canopen
from hil.devices.canopen import JointNode, NodeState, Reading
from hil.devices.wheel import NO_JOINT
from hil.world.sensors import generator

TimedFrame = tuple[int, int, bytes, bool]  # end on the bus [ns], identifier, data, is CAN FD
RESPONSE_NS = 30_000.0  # SYNC received to PDO ready
RESPONSE_JITTER_NS = 20_000.0


class Latch(Protocol):
    """Measures every joint of the robot at one instant."""

    def __call__(self, t_ns: int) -> Sequence[Reading]:
        """Return one reading per joint of the robot."""
        ...


def duration_ns(length: int, is_fd: bool, stuff_bits: float) -> float:
    """Return the bus time [ns] of a frame with `length` data bytes, with interframe space.

    Classic at 1 Mbit/s; FD 1 Mbit/s arbitration and 5 Mbit/s data (ISO, bit-rate switch).
    """
    if is_fd:
        return 30e3 + 200.0 * (8 * length + 35) + 200.0 * stuff_bits
    return 1e3 * (47 + 8 * length + stuff_bits)


def _uniform_draws(rng: np.random.Generator) -> Iterator[float]:
    while True:
        yield from rng.random(1024).tolist()


class SyncProducer:
    """A node that produces SYNC on a bus whose host only consumes SYNC."""

    def __init__(self, rate_hz: float, counter_max: int, t0_ns: int) -> None:
        self._period_ns = 1e9 / rate_hz
        self._max = counter_max
        self._t0_ns = t0_ns
        self._sent = 0

    def next_ns(self) -> int:
        """Return the time of the next SYNC [ns]."""
        return self._t0_ns + round((self._sent + 1) * self._period_ns)

    def payload(self) -> bytes:
        """Return the data of the next SYNC, a counter if it has one; count this SYNC as sent."""
        self._sent += 1
        return bytes([(self._sent - 1) % self._max + 1]) if self._max else b""


class CanSegment:
    """Nodes of one bus, or of a redundant pair (lines 0 and 1); each node uses one line.

    Frames wait in order of identifier until the line is free.
    """

    def __init__(
        self,
        name: str,
        nodes: dict[int, JointNode],
        latch: Latch,
        seed: int,
        *,
        index: int,
        heartbeat_s: float,
        t0_ns: int,
    ) -> None:
        self.name = name
        self.nodes = nodes  # by joint index in the robot; wheels follow all joints
        self._latch = latch
        self._by_id = sorted(nodes.items(), key=lambda item: item[1].node_id)
        self._toggles = [node.toggle for node in nodes.values() if node.toggle is not None]
        self._draws = _uniform_draws(generator(seed, "bus", index))
        self._t0_ns = t0_ns
        self._busy_ns = [float(t0_ns), float(t0_ns)]
        for toggle in self._toggles:
            toggle.power_on(t0_ns)
        period = heartbeat_s * 1e9
        self._period_ns = period
        # boot-up frames at power-on, then heartbeats spread over the period
        self._booting = list(nodes.values())
        self._heartbeat_ns = {
            joint: t0_ns + period * (1.0 + i / len(nodes)) for i, joint in enumerate(nodes)
        }
        self._unasked_ns = float(t0_ns)  # time of the next heartbeat

    def _place(
        self, ready_ns: float, can_id: int, data: bytes, is_fd: bool, line: int = 0
    ) -> TimedFrame:
        """Put a frame on a line when the frame is ready and the line free; return the frame."""
        length, busy_ns = len(data), self._busy_ns
        stuff_bits = next(self._draws) * (34 + 8 * length) / 8.0
        start_ns = ready_ns if ready_ns > busy_ns[line] else busy_ns[line]
        busy_ns[line] = end_ns = start_ns + duration_ns(length, is_fd, stuff_bits)
        return round(end_ns), can_id, data, is_fd

    def _listening(self, t_ns: int, line: int) -> dict[int, JointNode]:
        """Return the nodes that use a line at this time, by joint index."""
        for toggle in self._toggles:
            toggle.advance(t_ns)
        if not self._toggles and line == 0:
            return self.nodes
        return {joint: node for joint, node in self.nodes.items() if node.line == line}

    def on_frame(self, t_ns: int, can_id: int, data: bytes, line: int = 0) -> list[TimedFrame]:
        """Accept a frame of the host; return the answers of the line's nodes, in bus order."""
        listening = self._listening(t_ns, line)
        nodes = listening.values()
        if can_id == canopen.SYNC_ID and len(data) == 1:
            return self._on_sync(t_ns, data[0], listening, line)
        if can_id == canopen.NMT_ID and len(data) == 2:
            restarted = [n for n in nodes if n.on_nmt(data[0], data[1])]
            return [self._place(t_ns + 1e6, *self._state_of(n, boot=True), line) for n in restarted]
        if 0x600 < can_id < 0x680:
            for node in nodes:
                reply = node.on_sdo(data) if node.node_id == can_id - 0x600 else None
                if reply is not None:
                    return [self._place(t_ns + 5e5, 0x580 + node.node_id, reply, False, line)]
        for toggle in (node.toggle for node in nodes):
            if toggle is not None and can_id == 0x700 + toggle.config.master_node_id:
                toggle.heard(t_ns)
        return []

    def _on_sync(
        self, t_ns: int, counter: int, nodes: dict[int, JointNode], line: int
    ) -> list[TimedFrame]:
        readings = self._latch(t_ns)
        t_us = (t_ns - self._t0_ns) // 1000
        first: list[tuple[int, bytes, bool]] = []  # TPDO1 before TPDO2: in order of identifier
        second: list[tuple[int, bytes, bool]] = []
        for joint, node in self._by_id:
            reading = readings[joint] if joint < len(readings) else NO_JOINT
            pdos = node.on_sync(counter, reading, t_us) if joint in nodes else ()
            if pdos:
                first.append((0x180 + node.node_id, pdos[0], node.is_fd))
            if len(pdos) > 1:
                second.append((0x280 + node.node_id, pdos[1], node.is_fd))
        sync_end = t_ns + duration_ns(1, False, 4.0)
        ready_ns = sync_end + RESPONSE_NS + RESPONSE_JITTER_NS * next(self._draws)
        return [self._place(ready_ns, *frame, line) for frame in first + second]

    @staticmethod
    def _state_of(node: JointNode, *, boot: bool = False) -> tuple[int, bytes, bool]:
        state = NodeState.BOOT_UP if boot else node.state
        return 0x700 + node.node_id, bytes([state]), False

    def frames_until(self, t_ns: int, line: int = 0) -> list[TimedFrame]:
        """Return the boot-up frames and heartbeats that nodes of a line send until this time."""
        if t_ns < self._unasked_ns and not self._booting:
            return []
        listening = self._listening(t_ns, line)
        booting = [node for node in self._booting if node.line == line]
        self._booting = [node for node in self._booting if node.line != line]
        frames = [self._place(self._t0_ns, *self._state_of(n, boot=True), line) for n in booting]
        for joint, node in listening.items():
            while self._heartbeat_ns[joint] <= t_ns:
                if not node.silent:
                    beat = self._state_of(node)
                    frames.append(self._place(self._heartbeat_ns[joint], *beat, line))
                self._heartbeat_ns[joint] += self._period_ns
        self._unasked_ns = min(self._heartbeat_ns.values())
        return frames

    def emergency(self, t_ns: int, joint: int, code: int, register: int) -> TimedFrame:
        """Return an EMCY frame of the joint's node."""
        data = canopen.encode_emergency(code, register)
        node = self.nodes[joint]
        return self._place(t_ns, canopen.SYNC_ID + node.node_id, data, False, node.line)
