"""The simulated robot's devices: CAN frames in, CAN frames and serial bytes out, all timed.

`Plant` reads no clock: every time is an argument. The same class therefore serves virtual time (see
`hil.links.virtual`) and real time (`python -m hil.devices PLANT.yaml`).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.devices.bus_toggle import BusToggle
from hil.devices.can_segment import CanSegment, SyncProducer, TimedFrame
from hil.devices.canopen import SYNC_ID, FieldScale, JointNode, Reading
from hil.devices.described import drives_of
from hil.devices.dialects import Drive, dialect_of
from hil.devices.feed import Feed
from hil.devices.foreign import ForeignSegment
from hil.devices.imu import Imu
from hil.devices.star_tracker import StarTracker
from hil.devices.thruster import ThrusterNode
from hil.devices.truth_clock import SPAN_S, ClampedHistory, JointTable, TruthClock
from hil.devices.truth_port import History
from hil.devices.uart import TimedBytes
from hil.devices.wheel import WheelNode
from hil.world.sensor_config import NodeConfig, SensorConfig, WheelSensorConfig
from hil.world.sensors import JointErrors, generator
from hil.world.thrusters import ThrusterSystem

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
FIRST_NODE = 0x11
AHEAD = 64  # latches measured in one batch


class Plant:
    """All devices of one robot.

    Parameters
    ----------
    history : truth; its time zero is `start_delay_s` after the first SYNC
    sensors : devices and their errors
    seed : fixes every random bit of every device
    t0_ns : power-on, on the host's clock
    sync_rate_hz : rate of the host's SYNC, at which noise blocks are sampled
    thrusters : thrusters whose valves the thruster node of `sensors` reports
    sliding : which joints are prismatic, base to tool; empty: none
    """

    def __init__(
        self,
        history: History,
        sensors: SensorConfig,
        seed: int,
        *,
        start_delay_s: float = 4.0,
        t0_ns: int = 0,
        sync_rate_hz: float = 500.0,
        thrusters: ThrusterSystem | None = None,
        sliding: Sequence[bool] = (),
    ) -> None:
        self.sensors = sensors
        self.clock = TruthClock(start_delay_s)
        rested = ClampedHistory(history)
        self._table = JointTable(rested)
        n = self._table.n
        default = tuple(NodeConfig(node_id=FIRST_NODE + i) for i in range(n))
        self.nodes = sensors.joints.nodes or default
        if len(self.nodes) != n:
            raise ValueError(f"joints.nodes: {len(self.nodes)} nodes for a robot of {n} joints")
        feed = sensors.joints.feed
        rate_hz = sensors.joints.sync_rate_hz or sync_rate_hz
        self._rate_hz = rate_hz = rate_hz if feed is None else feed.rate_hz
        self.joint_errors = JointErrors(sensors.joints, n, seed, rate_hz, sliding)
        if sensors.joints.torque == "motor_current":
            self._table.measure_at_motors(self.joint_errors.motor_side)
        self._signs = np.array([float(node.sign) for node in self.nodes])
        self._gains = np.array([node.torque_gain for node in self.nodes])
        self._offsets_nm = np.array([node.torque_offset_nm for node in self.nodes])
        self._zeros = np.array([node.zero_offset_rad for node in self.nodes])
        self._torque_delays_s = np.array([node.torque_delay_s for node in self.nodes])
        is_fd = [node.format == "fd" for node in self.nodes]
        self._is_fd = np.array(is_fd)
        self._scale = FieldScale(is_fd, sensors.joints.torque_range_nm, sliding)
        self._latched_ns = t0_ns
        self._readings: list[Reading] = []  # of the latch at _latched_ns
        self._step_ns = 0  # time from the latch before to this latch
        self._ahead: list[tuple[int, list[Reading]]] = []  # future latches, the next one last
        self._rested = rested
        self._others = self._wheel_nodes(sensors.wheels, seed, rate_hz)
        self._add_thruster_node(thrusters, rate_hz)
        names = tuple(dict.fromkeys([*(node.bus for node in self.nodes), *self._others]))
        self.segments = {
            name: self._segment(name, index, seed, t0_ns) for index, name in enumerate(names)
        }
        self.imu = (
            Imu(sensors.imu, rested, self.clock, seed, t0_ns) if sensors.imu is not None else None
        )
        self.star_tracker = (
            StarTracker(sensors.star_tracker, rested, self.clock, seed, t0_ns)
            if sensors.star_tracker is not None
            else None
        )
        self.feeds = {} if feed is None else {names[0]: Feed(feed, self._sampled, seed, t0_ns)}
        self.lines: dict[str, Imu | StarTracker | Feed] = dict(self.feeds)
        if self.imu is not None:
            self.lines["imu"] = self.imu
        if self.star_tracker is not None:
            self.lines["star_tracker"] = self.star_tracker

    def _segment(self, name: str, index: int, seed: int, t0_ns: int) -> CanSegment | ForeignSegment:
        joints = self.sensors.joints
        nodes: dict[int, JointNode] = {
            i: JointNode(
                node_id=node.node_id,
                joint=i + 1,
                is_fd=node.format == "fd",
                torque_sensor=node.torque_sensor,
                autostart=joints.autostart,
                sync_counter_max=joints.sync_counter_max,
                toggle=None if joints.redundancy is None else BusToggle(joints.redundancy),
            )
            for i, node in enumerate(self.nodes)
            if node.bus == name
        }
        nodes |= self._others.get(name, {})
        own = {i: node for i, node in enumerate(self.nodes) if node.bus == name}
        drives = self._drives(own)
        if drives:
            return ForeignSegment(
                name,
                drives,
                {i: node.node_id for i, node in own.items()},
                self._measure,
                seed,
                index=index,
                rate_hz=self._rate_hz,
                t0_ns=t0_ns,
                sync_bytes=int(joints.dialect is None and joints.sync_counter_max > 0),
            )
        return CanSegment(
            name,
            nodes,
            self._latch,
            seed,
            index=index,
            heartbeat_s=joints.heartbeat_s,
            t0_ns=t0_ns,
        )

    def _drives(self, nodes: Mapping[int, NodeConfig]) -> dict[tuple[int, ...], Drive]:
        """Return the drives of a bus by their joints; none: they speak the tailored format."""
        joints = self.sensors.joints
        if joints.dialect is not None:
            own = dialect_of(joints.dialect)
            return {(i,): own for i in nodes}
        told = {i: (n.node_id, n.described) for i, n in nodes.items() if n.described is not None}
        return dict(drives_of(told, joints.latch_offset_s))

    def _measure(self, joint: int, t_ns: float) -> tuple[float, float, float]:
        """Return position, speed and torque of one joint at any instant, in its own sign and zero.

        A sample uses up the errors of all joints at one latch; they are white.
        """
        self.joint_errors.left()
        position, torque, speed, _ = self._values(np.array([self.clock.second(round(t_ns))]))
        self.joint_errors.use()
        sign = self._signs[joint]
        measured = (position[0, joint], speed[0, joint], torque[0, joint])
        return tuple(float(sign * value) for value in measured)  # type: ignore[return-value]

    def _latch(self, t_ns: int) -> Sequence[Reading]:
        """Measure every joint; buses with the same SYNC instant share the latch."""
        if self._latched_ns == t_ns and self._readings:
            return self._readings
        step_ns, self._latched_ns = t_ns - self._latched_ns, t_ns
        if not (self._ahead and self._ahead[-1][0] == t_ns):
            # after two equal steps, as in virtual time, the next steps are expected to be equal
            count = AHEAD if step_ns == self._step_ns else 1
            self._ahead = self._measured(t_ns, step_ns, count)
        self._step_ns = step_ns
        self._readings = self._ahead.pop()[1]
        self.joint_errors.use()
        return self._readings

    def _measured(self, t_ns: int, step_ns: int, count: int) -> list[tuple[int, list[Reading]]]:
        """Return times and readings of `count` latches from `t_ns`, in reverse order."""
        config = self.sensors.joints
        count = min(count, self.joint_errors.left(), 1 + int(SPAN_S * 1e9) // max(step_ns, 1))
        times_ns = [t_ns + k * step_ns for k in range(count)]
        t_s = np.array([self.clock.second(t) for t in times_ns]) + config.latch_offset_s
        position, torque, speed, tau = self._values(t_s)
        blind = self.joint_errors.speed_only
        if blind.any():  # classic frames have speed in place of position
            position[:, blind] = np.where(self._is_fd[blind], 0.0, speed[:, blind])
        measured = np.stack([position, speed, torque, tau / config.rated_torque_nm])
        measured *= self._signs
        return list(zip(times_ns, self._scale.readings(measured), strict=True))[::-1]

    def _values(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return positions, torques, speeds as measured, and true torques (k, n), without sign."""
        rate, load = self._loads(t_s)
        q, qd, tau = self._table.at(t_s)
        position, torque = self.joint_errors.ahead(q, rate, load)
        blind = np.flatnonzero(self.joint_errors.speed_only)
        if blind.size:
            qd = qd.copy()
            qd[:, blind] = self.joint_errors.speeds_ahead(qd)
        return position - self._zeros, torque * self._gains + self._offsets_nm, qd, tau

    def _loads(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the true rates and torques (k, n) that the torque sensors show."""
        rate, load = np.empty((2, len(t_s), self._table.n))
        for delay_s in np.unique(self._torque_delays_s)[::-1]:  # the table is filled from the first
            own = self._torque_delays_s == delay_s
            _, rates, loads = self._table.at(t_s - delay_s)
            rate[:, own], load[:, own] = rates[:, own], loads[:, own]
        return rate, load

    def _sampled(self, times_ns: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the joints' raw positions, torques and speeds (k, n) at host times (k,)."""
        parts, at = [], 0
        offset_s = self.sensors.joints.latch_offset_s
        while at < len(times_ns):
            reach = np.searchsorted(times_ns, times_ns[at] + int(0.9 * SPAN_S * 1e9))
            stop = min(int(reach), at + max(1, self.joint_errors.left()))
            found = self._values(self.clock.seconds(times_ns[at:stop]) + offset_s)
            for _ in range(at, stop):
                self.joint_errors.use()
            parts.append([self._signs * values for values in found[:3]])
            at = stop
        position, torque, speed = (np.concatenate(column) for column in zip(*parts, strict=True))
        return position, torque, speed

    def _wheel_nodes(
        self, config: WheelSensorConfig | None, seed: int, sync_rate_hz: float
    ) -> dict[str, dict[int, JointNode]]:
        """Return the wheel nodes by bus and index; the indices follow the joints'."""
        nodes: dict[str, dict[int, JointNode]] = {}
        joints = self.sensors.joints
        if config is None:
            return nodes
        for k, own in enumerate(config.nodes):
            node = WheelNode(
                node_id=own.node_id,
                joint=self._table.n + k + 1,
                autostart=joints.autostart,
                sync_counter_max=joints.sync_counter_max,
                toggle=None if joints.redundancy is None else BusToggle(joints.redundancy),
                syncs_per_report=max(1, round(sync_rate_hz / config.rate_hz)),
                measure=self._tachometer(k, config, seed),
            )
            nodes.setdefault(own.bus, {})[self._table.n + k] = node
        return nodes

    def _add_thruster_node(self, thrusters: ThrusterSystem | None, sync_rate_hz: float) -> None:
        """Add the valve driver; its index follows the indices of joints and wheels."""
        config, joints = self.sensors.thrusters, self.sensors.joints
        if config is None or thrusters is None:
            return

        def look() -> tuple[list[bool], float | None, int]:
            return thrusters.valves_at(self.clock.second(self._latched_ns) + joints.latch_offset_s)

        place = self._table.n + sum(len(nodes) for nodes in self._others.values())
        self._others.setdefault(config.bus, {})[place] = ThrusterNode(
            node_id=config.node_id,
            joint=place + 1,
            autostart=joints.autostart,
            sync_counter_max=joints.sync_counter_max,
            toggle=None if joints.redundancy is None else BusToggle(joints.redundancy),
            syncs_per_report=max(1, round(sync_rate_hz / config.rate_hz)),
            look=look,
        )

    def _tachometer(
        self, k: int, config: WheelSensorConfig, seed: int
    ) -> Callable[[], tuple[float, float]]:
        """Return a function that measures one wheel at the newest latch: speed, motor torque."""
        rng = generator(seed, "wheel", k)
        offset_nm = config.torque_offset_sigma_nm * float(rng.standard_normal())

        def measure() -> tuple[float, float]:
            latch_s = self.sensors.joints.latch_offset_s
            speed, torque = self._rested.wheels_at(self.clock.second(self._latched_ns) + latch_s)
            noise = rng.standard_normal(2)
            return (
                float(speed[k] + config.speed_noise_rad_s * noise[0]),
                float(torque[k] + offset_nm + config.torque_noise_nm * noise[1]),
            )

        return measure

    def is_foreign(self, bus: str) -> bool:
        """Return whether the drives of a bus are of other makers."""
        return isinstance(self.segments[bus], ForeignSegment)

    @property
    def is_free(self) -> bool:
        """Whether joints are measured without a SYNC; the truth then does not wait for one."""
        foreign = [own for own in self.segments.values() if isinstance(own, ForeignSegment)]
        return bool(self.feeds) or any(segment.is_free for segment in foreign)

    def next_frame_ns(self, bus: str) -> float:
        """Return when a drive of another maker acts next [ns]; infinite without such drives."""
        segment = self.segments[bus]
        return segment.next_ns() if isinstance(segment, ForeignSegment) else math.inf

    def sync_producer(self, t0_ns: int) -> SyncProducer | None:
        """Return a SYNC producer from `t0_ns`, or None if the host produces SYNC."""
        joints = self.sensors.joints
        if joints.sync_rate_hz is None:
            return None
        return SyncProducer(joints.sync_rate_hz, joints.sync_counter_max, t0_ns)

    def _bus(self, bus: str | None) -> CanSegment | ForeignSegment:
        return self.segments[bus] if bus is not None else next(iter(self.segments.values()))

    def on_frame(
        self, t_ns: int, can_id: int, data: bytes, bus: str | None = None, line: int = 0
    ) -> list[TimedFrame]:
        """Accept a frame that the host sent at `t_ns`; return the answers with arrival times."""
        if can_id == SYNC_ID:
            self.clock.start(t_ns)
        return self._bus(bus).on_frame(t_ns, can_id, data, line)

    def frames_until(self, t_ns: int, bus: str | None = None, line: int = 0) -> list[TimedFrame]:
        """Return boot-up frames and heartbeats due by this time, with their arrival times."""
        return self._bus(bus).frames_until(t_ns, line)

    def next_serial_ns(self, device: str | None = None) -> int | None:
        """Return the time of the next event on a serial line [ns]; None without lines."""
        lines = [self.lines[device]] if device is not None else list(self.lines.values())
        return min((line.next_ns() for line in lines), default=None)

    def serial_until(self, t_ns: int) -> dict[str, list[TimedBytes]]:
        """Return by device the chunks received by this time, with their arrival times."""
        return {name: line.take(t_ns) for name, line in self.lines.items()}

    def write_serial(self, t_ns: int, device: str, data: bytes) -> None:
        """Deliver bytes of the host to a device; the inertial unit ignores bytes."""
        if device == "star_tracker" and self.star_tracker is not None:
            self.star_tracker.write(t_ns, data)

    def times(self) -> dict[str, Any]:
        """Return the map from truth to host time: origin, and t0 and period of IMU samples."""
        imu = None if self.imu is None else self.imu.times()
        return {"origin_ns": self.clock.origin_ns, "imu": imu}
