"""Sensor models: what each device measures, and how wrong it is, before it becomes bytes.

Frames: N inertial, B base, S sensor; `R_NB` takes B components to N. Each device owns its random
streams (spawned from the one seed), so nothing done to one device changes another's noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict, TypeAdapter
from scipy.spatial.transform import Rotation

from hil.devices.truth_port import FloatArray, State
from hil.world.friction import draw_friction
from hil.world.noise import BandLimitedWhiteNoise, Hysteresis, NoiseStream

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Chunking = Literal["datagram", "ms1", "random"]
DEVICE_KEYS = {"bus": 0, "joint": 1, "imu": 2, "star_tracker": 3, "host": 4, "line": 5}
DEVICE_KEYS |= {"wheel": 6, "thruster": 7, "mode": 8}
STRICT = ConfigDict(extra="forbid")
HYSTERESIS_WIDTH_RATIO = 0.05  # of full scale: torque that takes a sensor from branch to branch


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeConfig:
    """One joint node and how its raw values relate to the URDF's joint.

    The node reports `sign * (q - zero_offset_rad)` and `sign * torque`; without a torque sensor
    zero, not valid. One whose encoder gives speed reports `sign * qd` and no position.
    """

    __pydantic_config__ = STRICT
    node_id: int
    bus: str = "arm"
    format: Literal["classic", "fd"] = "classic"
    sign: Literal[-1, 1] = 1
    zero_offset_rad: float = 0.0
    torque_sensor: bool = True
    encoder: Literal["position", "speed"] = "position"
    is_prismatic: bool = False  # counts 2^-24 m where another node counts 2^-24 revolutions


@dataclass(frozen=True, slots=True, kw_only=True)
class BusToggleConfig:
    """Nodes on a redundant pair of buses: object 0x2000, and the heartbeat they follow (0x1016)."""

    __pydantic_config__ = STRICT
    ttoggle: int = 2  # consumer heartbeat times without a heartbeat, then the node toggles
    ntoggle: int = 10  # toggles in a row, then the node stays
    consumer_heartbeat_s: float = 0.15
    master_node_id: int = 0x01


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSensorConfig:
    """Joint encoders and link-side torque sensors."""

    __pydantic_config__ = STRICT
    torque_noise_nm: float  # 1 sigma of one sample
    torque_noise_correlation_s: float = 0.0  # in which it fades by e; 0: white
    torque_offset_sigma_nm: float  # the constant offset of each joint is drawn once per seed
    torque_scale_error_ratio: float = 0.0  # 1 sigma, drawn once per joint and seed
    friction_coulomb_sigma_nm: float = 0.0  # on the link side, drawn once per joint and seed
    friction_viscous_sigma_nms_rad: float = 0.0
    torque_range_nm: float = 327.0  # beyond it the node reports an overload
    torque_hysteresis_ratio: float = 0.0  # of full scale, the rated torque
    torque_noise: BandLimitedWhiteNoise | None = None  # instead of torque_noise_nm
    position_noise: BandLimitedWhiteNoise | None = None  # instead of encoder_noise_rad
    encoder_bits: int = 24
    encoder_noise_rad: float = 0.0
    speed_noise_rad_s: float = 0.0  # of nodes whose encoder gives speed; 1 sigma of one sample
    start_sigma_rad: float = 2e-3  # of the angle that the flight side is told they begin at
    latch_offset_s: float = 0.0  # latch instant minus the SYNC stamp
    rated_torque_nm: float = 40.0
    heartbeat_s: float = 1.0
    autostart: bool = True  # become operational at the first SYNC unless told otherwise
    sync_counter_max: int = 240
    sync_rate_hz: float | None = None  # the plant produces SYNC itself (host a consumer)
    redundancy: BusToggleConfig | None = None  # None: one bus
    nodes: tuple[NodeConfig, ...] = ()  # empty: node 0x11 and on, classic, bus "arm"


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuSensorConfig:
    """Inertial unit: noise, mounting and time behaviour."""

    __pydantic_config__ = STRICT
    p_BS_m: Vector3
    q_BS_xyzw: Quaternion
    angle_random_walk_rad_sqrt_s: float
    velocity_random_walk_m_s_sqrt_s: float
    gyro_bias_sigma_rad_s: float
    acc_bias_sigma_m_s2: float
    noise_correlation_s: float = 0.0  # of both, in which the noise fades by e; 0: white
    gyro_bias_walk_rad_s_sqrt_s: float = 0.0  # rate random walk
    acc_bias_walk_m_s2_sqrt_s: float = 0.0
    rate_hz: int = 500
    baud_rate: int = 921600
    datagram_id: int = 0xA5
    crlf: bool = False
    acc_range_g: Literal[5, 10, 30, 80] = 10
    acceleration: Literal["specific_force", "kinematic"] = "specific_force"
    gyro_noise: BandLimitedWhiteNoise | None = None  # instead of the angle random walk
    acc_noise: BandLimitedWhiteNoise | None = None  # instead of the velocity random walk
    gyro_group_delay_s: float = 2.2e-3
    acc_group_delay_s: float = 6.3e-3
    latency_s: float = 3.0e-4  # sample instant to first bit
    latency_jitter_s: float = 3.0e-5  # uniform, added to it and reported in the latency field
    clock_error_ppm: float = 50.0  # bound of the uniform draw
    startup_s: float = 0.0  # start-up flag set this long after power-on
    chunking: Chunking = "datagram"
    chunk_clock_ppm: float = 500.0  # bound of the ms1 frame clock's error, a USB host's by default


@dataclass(frozen=True, slots=True, kw_only=True)
class StarTrackerSensorConfig:
    """Star tracker: noise about its axes (boresight z) and time behaviour."""

    __pydantic_config__ = STRICT
    p_BS_m: Vector3 = (0.0, 0.0, 0.0)
    q_BS_xyzw: Quaternion
    noise_across_rad: float = math.radians(2.0 / 3600.0)
    noise_about_rad: float = math.radians(10.0 / 3600.0)
    attitude_noise: BandLimitedWhiteNoise | None = None  # instead of both
    rate_hz: float = 5.0
    baud_rate: int = 115200
    latency_s: float = 0.1  # mid-exposure to the last byte of an unescaped frame
    latency_jitter_s: float = 0.0  # uniform, added
    stamp_offset_s: float = 0.0  # the unit's time stamp minus mid-exposure
    clock_error_ppm: float = 0.0  # bound of the uniform draw
    unix_epoch_s: float = 1.8e9  # the unit's Unix time at power-on
    rotation: Literal["inertial_to_tracker", "tracker_to_inertial"] = "inertial_to_tracker"
    subscribed: bool = False  # sends solutions without having been asked
    chunking: Chunking = "datagram"
    chunk_clock_ppm: float = 500.0  # bound of the ms1 frame clock's error, a USB host's by default


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelNodeConfig:
    """One reaction wheel node."""

    __pydantic_config__ = STRICT
    node_id: int
    bus: str = "arm"


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelSensorConfig:
    """Tachometers and motor torques of reaction wheels."""

    __pydantic_config__ = STRICT
    nodes: tuple[WheelNodeConfig, ...]  # one per rotor of the robot
    rate_hz: float = 50.0
    speed_noise_rad_s: float = 0.01  # white, 1 sigma of one sample
    torque_noise_nm: float = 1e-3
    torque_offset_sigma_nm: float = 5e-3  # constant, drawn once per wheel and seed
    torque_used: bool = False  # whether the flight side is to use the motor torques


@dataclass(frozen=True, slots=True, kw_only=True)
class ThrusterSensorConfig:
    """The valve driver: one node with a bit for each thruster."""

    __pydantic_config__ = STRICT
    node_id: int
    bus: str = "arm"
    rate_hz: float = 50.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorConfig:
    """All sensors of the plant."""

    __pydantic_config__ = STRICT
    joints: JointSensorConfig
    imu: ImuSensorConfig | None = None
    star_tracker: StarTrackerSensorConfig | None = None
    wheels: WheelSensorConfig | None = None
    thrusters: ThrusterSensorConfig | None = None

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> SensorConfig:
        """Validate a YAML mapping; unknown or missing keys raise ValueError."""
        sections = {key: _with_quaternion(section) for key, section in data.items()}
        return TypeAdapter(cls).validate_python(sections)


def _with_quaternion(section: object) -> object:
    """Put the quaternion in the place of roll, pitch, yaw about fixed axes, as in a URDF."""
    if not isinstance(section, dict) or "rpy_BS_rad" not in section or "q_BS_xyzw" in section:
        return section
    rest = {key: value for key, value in section.items() if key != "rpy_BS_rad"}
    angles = TypeAdapter(Vector3).validate_python(section["rpy_BS_rad"])
    return rest | {"q_BS_xyzw": Rotation.from_euler("xyz", angles).as_quat().tolist()}


def generator(seed: int, device: str, index: int = 0, stream: int = 0) -> np.random.Generator:
    """Return the random stream of one purpose of one device."""
    key = (DEVICE_KEYS[device], index, stream)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


@dataclass(slots=True)
class NormalStream:
    """Unit normal draws of one width, fetched in batches; the sequence is the generator's own."""

    rng: np.random.Generator
    width: int
    batch: int = 256
    _rows: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    _next: int = 0

    def draw(self) -> FloatArray:
        """Return the next row, shape (width,)."""
        if self._next >= len(self._rows):
            self._rows = self.rng.standard_normal((self.batch, self.width))
            self._next = 0
        self._next += 1
        row: FloatArray = self._rows[self._next - 1]
        return row


class Fading:
    """Makes white noise fade exponentially from sample to sample; its sigma stays."""

    def __init__(self, time_s: float, rate_hz: float, width: int) -> None:
        self._ratio = math.exp(-1.0 / (time_s * rate_hz)) if time_s > 0.0 else 0.0
        self._last = np.zeros(width)

    def of(self, white: FloatArray) -> FloatArray:
        """Return the next samples (k, width); without a correlation time they stay white."""
        if not self._ratio:
            return white
        from scipy.signal import lfilter  # 0.3 s that only such noise waits for

        fresh = math.sqrt(1.0 - self._ratio**2) * white
        start = self._ratio * self._last
        faded, _ = lfilter([1.0], [1.0, -self._ratio], fresh, axis=0, zi=start[None])
        self._last = faded[-1]
        return np.asarray(faded)


class JointErrors:
    """Encoder and torque sensor errors of n joints, drawn joint by joint."""

    def __init__(
        self, config: JointSensorConfig, n: int, seed: int, rate_hz: float = 500.0
    ) -> None:
        draws = [generator(seed, "joint", i, 1).standard_normal(2) for i in range(n)]
        self.config = config
        self.torque_offset_nm = config.torque_offset_sigma_nm * np.array([d[0] for d in draws])
        self.torque_scale = 1.0 + config.torque_scale_error_ratio * np.array([d[1] for d in draws])
        self.friction = draw_friction(
            generator(seed, "joint", 0, 2),
            n,
            coulomb_sigma_nm=config.friction_coulomb_sigma_nm,
            viscous_sigma_nms_rad=config.friction_viscous_sigma_nms_rad,
        )
        self._streams = [generator(seed, "joint", i, 0) for i in range(n)]
        self._blocks = [
            None if noise is None else NoiseStream(noise, rate_hz, n, seed, channel)
            for channel, noise in enumerate((config.position_noise, config.torque_noise))
        ]
        sigmas = (config.encoder_noise_rad, config.torque_noise_nm)
        self._sigmas = [
            sigma if block is None else 1.0
            for sigma, block in zip(sigmas, self._blocks, strict=True)
        ]
        self._fading = Fading(config.torque_noise_correlation_s, rate_hz, n)
        units = [1.0 if node.is_prismatic else 2.0 * math.pi for node in config.nodes]
        self._step_rad = (np.array(units) if units else 2.0 * math.pi) / 2**config.encoder_bits
        size_nm = config.torque_hysteresis_ratio * config.rated_torque_nm
        width_nm = HYSTERESIS_WIDTH_RATIO * config.rated_torque_nm
        self._hysteresis = Hysteresis(size_nm, width_nm, n) if size_nm > 0 else None
        self._noise = np.empty((0, 2, n))  # of the next latches: position, torque
        self.speed_only = np.array([node.encoder == "speed" for node in config.nodes], bool)
        self._of_speed = [
            generator(seed, "joint", i, 3) for i in np.flatnonzero(self.speed_only).tolist()
        ]
        self._speed_noise = np.empty((0, len(self._of_speed)))
        self._next = 0

    def _refill(self) -> None:
        rows = np.stack([s.standard_normal((256, 2)) for s in self._streams], axis=2)
        for column, block in enumerate(self._blocks):
            if block is not None:
                rows[:, column] = block.take(256)
            rows[:, column] *= self._sigmas[column]
        rows[:, 1] = self._fading.of(rows[:, 1])
        self._noise, self._next = rows, 0
        if self._of_speed:
            white = [stream.standard_normal(256) for stream in self._of_speed]
            self._speed_noise = self.config.speed_noise_rad_s * np.stack(white, axis=1)

    def left(self) -> int:
        """Return how many latches can be measured ahead: one where errors depend on the last."""
        if self._next >= len(self._noise):
            self._refill()
        return 1 if self._hysteresis is not None else len(self._noise) - self._next

    def ahead(
        self, q: FloatArray, qd: FloatArray, tau: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return measured position [rad], quantised, and link torque [N m] of the next latches.

        Parameters
        ----------
        q, qd, tau : (k, n) true position [rad], rate [rad/s], torque [N m]; k at most `left`

        `use` tells how many of them were needed: the rest is drawn again, the same.
        """
        noise = self._noise[self._next : self._next + len(q)]
        step_rad = self._step_rad
        position = np.rint((q + noise[:, 0]) / step_rad) * step_rad
        torque = (tau + self.friction.torque_nm(qd)) * self.torque_scale + self.torque_offset_nm
        if self._hysteresis is not None:
            torque = torque + self._hysteresis.error_nm(tau[0])
        return position, torque + noise[:, 1]

    def speeds_ahead(self, qd: FloatArray) -> FloatArray:
        """Return the speeds [rad/s] that encoders without position measure at the next latches.

        Parameters
        ----------
        qd : (k, n) true rates; as many latches as `ahead` was asked for

        Returns
        -------
        (k, m) of the m joints of `speed_only`
        """
        own = qd[:, np.flatnonzero(self.speed_only)]
        return np.asarray(own + self._speed_noise[self._next : self._next + len(qd)])

    def use(self) -> None:
        """Count one latch as measured."""
        self._next += 1

    def measure(
        self, q: FloatArray, qd: FloatArray, tau: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return measured position [rad], quantised, and link torque [N m] of one latch, (n,)."""
        self.left()
        position, torque = self.ahead(q[None], qd[None], tau[None])
        self.use()
        return position[0], torque[0]


class ImuErrors:
    """Noise and bias of the inertial unit, sample by sample in order."""

    def __init__(self, config: ImuSensorConfig, seed: int) -> None:
        turn_on = generator(seed, "imu", 0, 1).standard_normal(6)
        self.gyro_bias_rad_s: FloatArray = config.gyro_bias_sigma_rad_s * turn_on[:3]
        self.acc_bias_m_s2: FloatArray = config.acc_bias_sigma_m_s2 * turn_on[3:]
        root_rate = math.sqrt(config.rate_hz)
        self._sigma = np.repeat(
            [
                config.angle_random_walk_rad_sqrt_s * root_rate,
                config.velocity_random_walk_m_s_sqrt_s * root_rate,
            ],
            3,
        )
        walks = [config.gyro_bias_walk_rad_s_sqrt_s, config.acc_bias_walk_m_s2_sqrt_s]
        self._walk = np.repeat(walks, 3) / root_rate
        self._white = generator(seed, "imu", 0, 0)
        self._drift = generator(seed, "imu", 0, 2)
        self._bias = np.concatenate([self.gyro_bias_rad_s, self.acc_bias_m_s2])
        self._fading = Fading(config.noise_correlation_s, config.rate_hz, 6)
        self._blocks = [
            None if noise is None else NoiseStream(noise, config.rate_hz, 3, seed, 2 + channel)
            for channel, noise in enumerate((config.gyro_noise, config.acc_noise))
        ]

    def next(self, count: int) -> FloatArray:
        """Return the next `count` errors, columns gyro [rad/s] 3, accelerometer [m/s^2] 3."""
        white = self._fading.of(self._sigma * self._white.standard_normal((count, 6)))
        for channel, block in enumerate(self._blocks):
            if block is not None:
                white[:, 3 * channel : 3 * channel + 3] = block.take(count)
        steps = self._walk * self._drift.standard_normal((count, 6))
        bias: FloatArray = self._bias + np.cumsum(steps, axis=0)
        self._bias = bias[-1]
        return bias + white


def rotation_of(q_xyzw: Quaternion) -> FloatArray:
    """Return the rotation matrix of a unit quaternion."""
    matrix: FloatArray = Rotation.from_quat(q_xyzw).as_matrix()
    return matrix


def angular_rate(state: State, R_BS: FloatArray) -> FloatArray:
    """Return w_NS_S [rad/s], shape (k, 3)."""
    rate: FloatArray = state.w_NB_B @ R_BS
    return rate


def specific_force(
    state: State,
    p_BS_m: Vector3,
    R_BS: FloatArray,
    reading: Literal["specific_force", "kinematic"] = "specific_force",
) -> FloatArray:
    """Return f_NS_S [m/s^2], shape (k, 3): what an accelerometer at its place reads.

    f = R_SB (a + wd x r + w x (w x r) - g(r)), a the classical acceleration of the base origin and
    g gravity at the sensor's place. "kinematic": without g, an acceleration no sensor gives.
    """
    r = np.asarray(p_BS_m)
    w = state.w_NB_B
    force: FloatArray = state.a_NB_B + np.cross(state.wd_NB_B, r) + np.cross(w, np.cross(w, r))
    if reading == "specific_force":
        force = force - state.g_NB_B - state.gradient_B @ r
    return np.asarray(force @ R_BS)


def attitude(
    R_NB: FloatArray, config: StarTrackerSensorConfig, normal: FloatArray
) -> tuple[float, float, float, float]:
    """Return the reported quaternion w x y z of one exposure, `normal` being 3 unit draws.

    The noise is a small rotation about the tracker's own axes, z the boresight.
    """
    R_SN = rotation_of(config.q_BS_xyzw).T @ R_NB.T
    sigma = np.array([config.noise_across_rad, config.noise_across_rad, config.noise_about_rad])
    if config.attitude_noise is not None:
        sigma = np.full(3, config.attitude_noise.sigma(config.rate_hz))
    measured = Rotation.from_rotvec(sigma * normal) * Rotation.from_matrix(R_SN)
    if config.rotation == "tracker_to_inertial":
        measured = measured.inv()
    x, y, z, w = measured.as_quat()
    return float(w), float(x), float(y), float(z)
