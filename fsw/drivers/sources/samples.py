"""Samples that another program decoded: turns JSON messages of a recording into samples.

A message holds values as the sensor gave them, in SI units. Calibration and delays of the
configuration are applied as to values from the wire, with the message's stamp as receive stamp.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fsw.config import Config, ImuConfig, StarTrackerConfig, WrenchSensorConfig
from fsw.config.constants import STANDARD_GRAVITY_M_S2
from fsw.drivers.sources.counters import Counters
from fsw.drivers.sources.joint_calibration import Calibration
from fsw.drivers.sources.star_tracker import to_bus
from fsw.drivers.wire import ByteChunk, Reject
from fsw.errors import WRONG_CONTENT
from fsw.messages import (
    AttitudeSamples,
    DeviceSamples,
    FloatArray,
    ImuSamples,
    IntArray,
    JointSamples,
    Samples,
)
from fsw.messages.findings import Finding

POSITION, TORQUE = "position_rad", "torque_nm"  # keys of values of joints, by name
POSITION_M, FORCE_N = "position_m", "force_n"  # of prismatic joints; forces of wrench sensors too
SPEED = "speed_rad_s"  # key of joints whose encoder gives no position, and of actuators, by name
SPEED_M_S = "speed_m_s"  # of prismatic joints
RATE, FORCE = "w_NS_S_rad_s", "f_NS_S_m_s2"
QUATERNION = "q_xyzw"
NORM_TOLERANCE = 1e-2
NOTHING = (np.nan, np.nan, np.nan)
Row = Callable[[Mapping[str, Any]], Sequence[float]]
Build = Callable[[IntArray, IntArray, FloatArray], Samples]


class SampleSource:
    """One kind of decoded samples.

    Parameters
    ----------
    row : turns one message into numbers, NaN for a missing value; raises on a wrong message
    build : turns times of validity (k,), receive stamps (k,) and rows (k, width) into samples,
        without those out of range
    per_row : number of samples in a message
    """

    def __init__(self, row: Row, build: Build, per_row: int = 1) -> None:
        self.row, self.build, self._per_row = row, build, per_row
        self._counts = Counters()

    @property
    def counters(self) -> dict[str, int]:
        """Counters of samples and bytes."""
        return self._counts.as_dict()

    def lacks(self) -> str:
        """Return nothing: the import has already reported missing columns."""
        return ""

    def findings(self) -> Sequence[Finding]:
        """Return no finding: the import has already reported faults of the stamps."""
        return ()

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Do nothing: silence of a sensor is not judged in a recording of decoded samples."""

    def feed(self, chunks: Sequence[ByteChunk]) -> Samples:
        """Accept messages in order and return their samples."""
        stamps, rows = [], []
        for chunk in chunks:
            self._counts.received_bytes += len(chunk.data)
            try:
                rows.append(self.row(json.loads(chunk.data)))
                stamps.append(chunk.t_ns)
            except WRONG_CONTENT:
                self._counts.reject(Reject.LENGTH, len(chunk.data))
        t_ns = np.array(stamps, np.int64)
        samples = self.build(t_ns, t_ns, np.array(rows, np.float64))
        refused = len(rows) * self._per_row - len(samples)
        self._counts.accepted += len(samples)
        self._counts.rejected += refused
        self._counts.rejects[Reject.RANGE] += refused
        return samples


def joint_samples(config: Config) -> SampleSource:
    """Return the source of all joints: positions [rad] and torques [N m] by name of the joint.

    Joints with `encoder: speed` have speeds [rad/s] in place of positions. Prismatic joints have
    keys of their own, in m, N and m/s.
    """
    joints = config.joints
    names, n = [joint.name for joint in joints], len(joints)
    calibration, every = Calibration(joints, on_wire=False), np.arange(n)
    offsets_s = {bus.name: bus.latch_offset_s for bus in config.buses}
    offsets_ns = np.array([round(offsets_s[joint.bus] * 1e9) for joint in joints], np.int64)
    limits_nm = np.array([joint.torque_limit_nm for joint in joints])
    keys = [
        ((SPEED if joint.speed_only else POSITION), TORQUE)
        if joint.kind == "revolute"
        else ((SPEED_M_S if joint.speed_only else POSITION_M), FORCE_N)
        for joint in joints
    ]
    blind = np.array([joint.torque == "none" for joint in joints])

    def row(message: Mapping[str, Any]) -> list[float]:
        pairs = list(zip(names, keys, strict=True))
        found = [float(message[key][name]) for name, (key, _) in pairs]
        return found + [float(message.get(key, {}).get(name, np.nan)) for name, (_, key) in pairs]

    def build(t_ns: IntArray, t_receive_ns: IntArray, values: FloatArray) -> JointSamples:
        joint, stamps = np.tile(every, len(t_ns)), np.repeat(t_ns, n)
        received = np.repeat(t_receive_ns, n)
        values = values.reshape(len(t_ns), 2, n)
        angle, force = calibration.apply(joint, values[:, 0].ravel(), values[:, 1].ravel())
        force[blind[joint]] = np.nan
        good = np.isfinite(angle) & ~(np.abs(force) > limits_nm[joint])
        stamps, received, joint = stamps[good], received[good], joint[good]
        return JointSamples(stamps + offsets_ns[joint], received, joint, angle[good], force[good])

    return SampleSource(row, build, n)


def wrench_samples(sensors: Sequence[WrenchSensorConfig]) -> SampleSource:
    """Return the source of all wrench sensors: lists of x, y, z by name of the sensor [N, N m]."""
    names = [sensor.name for sensor in sensors]
    limits = np.array([sensor.limits for sensor in sensors])
    signs = np.array([sensor.sign for sensor in sensors])
    delays_ns = np.array([round(sensor.delay_s * 1e9) for sensor in sensors], np.int64)

    def row(message: Mapping[str, Any]) -> list[float]:
        found = list[float]()
        for name in names:
            for key in (FORCE_N, TORQUE):
                x, y, z = message[key].get(name, NOTHING)
                found += [float(x), float(y), float(z)]
        return found

    def build(t_ns: IntArray, t_receive_ns: IntArray, values: FloatArray) -> DeviceSamples:
        sensor, stamps = np.tile(np.arange(len(names)), len(t_ns)), np.repeat(t_ns, len(names))
        wrench = values.reshape(-1, 6)
        good = (np.abs(wrench) <= limits[sensor]).all(axis=1)
        sensor, stamps, wrench = sensor[good], stamps[good], wrench[good]
        wrench = wrench * signs[sensor, None]
        received = np.repeat(t_receive_ns, len(names))[good]
        stamps = stamps - delays_ns[sensor]
        return DeviceSamples("wrench_sensors", stamps, received, sensor, wrench)

    return SampleSource(row, build, len(names))


def calibrated(config: ImuConfig, samples: ImuSamples) -> ImuSamples:
    """Return samples of an inertial unit without its known biases and the errors of its axes."""
    rate = samples.w_NS_S_rad_s - np.array(config.gyro_bias_S_rad_s)
    return replace(
        samples,
        w_NS_S_rad_s=rate @ np.array(config.gyro_matrix).T,
        f_NS_S_m_s2=samples.f_NS_S_m_s2 - np.array(config.acc_bias_S_m_s2),
    )


def imu_samples(config: ImuConfig) -> SampleSource:
    """Return the source of the inertial unit: rates [rad/s] and specific forces [m/s^2] in S."""
    force_limit = config.acc_range_g * STANDARD_GRAVITY_M_S2
    gyro_ns, acc_ns = (
        round(s * 1e9) for s in (config.gyro_group_delay_s, config.acc_group_delay_s)
    )

    def row(message: Mapping[str, Any]) -> list[float]:
        wx, wy, wz = message.get(RATE, NOTHING)
        fx, fy, fz = message.get(FORCE, NOTHING)
        return [float(value) for value in (wx, wy, wz, fx, fy, fz)]

    def build(t_ns: IntArray, t_receive_ns: IntArray, values: FloatArray) -> ImuSamples:
        values = values.reshape(-1, 6)
        far = (np.abs(values[:, :3]) > config.max_rate_rad_s).any(axis=1)
        far |= (np.abs(values[:, 3:]) > force_limit).any(axis=1)
        t_ns, t_receive_ns, values = t_ns[~far], t_receive_ns[~far], values[~far]
        w, f = values[:, :3], values[:, 3:]
        return calibrated(config, ImuSamples(t_ns - gyro_ns, t_ns - acc_ns, t_receive_ns, w, f))

    return SampleSource(row, build)


def attitude_samples(config: StarTrackerConfig) -> SampleSource:
    """Return the source of the star tracker: the unit's quaternions, scalar last."""
    latency_ns = round(config.latency_s * 1e9)

    def row(message: Mapping[str, Any]) -> list[float]:
        x, y, z, w = (float(value) for value in message[QUATERNION])
        return [x, y, z, w]

    def build(t_ns: IntArray, t_receive_ns: IntArray, values: FloatArray) -> AttitudeSamples:
        values = values.reshape(-1, 4)
        with np.errstate(over="ignore"):
            good = np.abs(np.sqrt((values * values).sum(axis=1)) - 1.0) <= NORM_TOLERANCE
        turned = [
            to_bus((w, x, y, z), config.mounting.q_BS_xyzw, config.rotation)
            for x, y, z, w in values[good].tolist()
        ]
        attitudes = np.array(turned).reshape(-1, 4)
        return AttitudeSamples(t_ns[good] - latency_ns, t_receive_ns[good], attitudes)

    return SampleSource(row, build)
