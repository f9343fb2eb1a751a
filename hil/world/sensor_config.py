"""Sections of a scenario's sensors: data sheets, mounting and time behaviour of each device."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict, TypeAdapter, model_validator
from scipy.spatial.transform import Rotation

from hil.world.noise import BandLimitedWhiteNoise

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Chunking = Literal["datagram", "ms1", "random"]
EYE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
STRICT = ConfigDict(extra="forbid")


def _with_quaternion(section: object) -> object:
    """Return a section with q_BS_xyzw in place of rpy_BS_rad (fixed axes, as in a URDF)."""
    if not isinstance(section, dict) or "rpy_BS_rad" not in section or "q_BS_xyzw" in section:
        return section
    rest, angles = dict(section), section["rpy_BS_rad"]
    del rest["rpy_BS_rad"]
    if not (isinstance(angles, list | tuple) and len(angles) == 3 and all(map(_is_angle, angles))):
        raise ValueError(f"rpy_BS_rad: must be three angles of at most 2 pi rad (value: {angles})")
    return rest | {"q_BS_xyzw": Rotation.from_euler("xyz", angles).as_quat().tolist()}


def _is_angle(value: object) -> bool:
    return isinstance(value, int | float) and abs(value) <= math.tau


@dataclass(frozen=True, slots=True, kw_only=True)
class DescribedConfig:
    """Frames of a joint's drive, by a description; keys are those of a configuration."""

    __pydantic_config__ = STRICT
    signals: Mapping[str, Mapping[str, Any]]  # by role: message, signal, unit
    timing: Mapping[str, Any]
    description: Path | None = None  # DBC and its kin; EDS or DCF of the node
    messages: tuple[Mapping[str, Any], ...] = ()
    bus: Mapping[str, Any] = field(default_factory=dict)  # keys of its bus, such as sync

    @property
    def fd(self) -> bool:
        """Whether its frames are those of CAN FD."""
        return bool(self.bus.get("fd", False))


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeConfig:
    """One joint node and how its raw values relate to the URDF's joint.

    The node reports `sign * (q - zero_offset_rad)` and `sign * (torque_gain * torque +
    torque_offset_nm)`. Without a torque sensor
    the torque is zero and invalid; with a speed encoder the node reports `sign * qd`, no position.
    Of a joint that the URDF calls prismatic these are metres and newtons.
    """

    __pydantic_config__ = STRICT
    node_id: int
    bus: str = "arm"
    format: Literal["classic", "fd"] = "classic"
    sign: Literal[-1, 1] = 1
    zero_offset_rad: float = 0.0
    torque_sensor: bool = True
    torque_gain: float = 1.0
    torque_offset_nm: float = 0.0
    torque_delay_s: float = 0.0  # the torque in a message is that much older than the position
    encoder: Literal["position", "speed"] = "position"
    described: DescribedConfig | None = None  # null: it speaks the tailored format, or a dialect


@dataclass(frozen=True, slots=True, kw_only=True)
class BusToggleConfig:
    """Redundant pair of buses: objects 0x2000 (toggling) and 0x1016 (heartbeat of the master)."""

    __pydantic_config__ = STRICT
    ttoggle: int = 2  # consumer heartbeat times without a heartbeat before the node toggles
    ntoggle: int = 10  # toggles in a row before the node stays
    consumer_heartbeat_s: float = 0.15
    master_node_id: int = 0x01


@dataclass(frozen=True, slots=True, kw_only=True)
class FeedConfig:
    """A program beside the arm's controller that sends all joints in datagrams, on its clock."""

    __pydantic_config__ = STRICT
    rate_hz: float
    source: int = 7
    encoding: Literal["packed", "json"] = "packed"
    clock: Literal["monotonic", "unix", "tai", "device"] = "monotonic"  # monotonic: the host's
    clock_offset_s: float = 0.0  # of another clock: its time at power-on
    clock_error_ppm: float = 0.0  # bound of the uniform draw of another clock's error
    latency_s: float = 3.0e-4  # from the sample to the sending
    delay_s: float = 5.0e-5  # least time from sending to arrival
    jitter_s: float = 5.0e-5  # mean of what is added to it, exponential
    loss_ratio: float = 0.0  # share of datagrams that never arrive
    key_hex: str | None = None  # 32 bytes
    order: tuple[int, ...] = ()  # joints in the order in which they are sent; empty: base to tool


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSensorConfig:
    """Joint encoders and link-side torque sensors."""

    __pydantic_config__ = STRICT
    torque_noise_nm: float  # 1 sigma of one sample
    torque_noise_correlation_s: float = 0.0  # correlation falls by e in this time; 0: white
    torque_offset_sigma_nm: float  # the constant offset of each joint is drawn once per seed
    torque_scale_error_ratio: float = 0.0  # 1 sigma, drawn once per joint and seed
    friction_coulomb_sigma_nm: float = 0.0  # on the link side, drawn once per joint and seed
    friction_viscous_sigma_nms_rad: float = 0.0
    torque: Literal["link_side", "motor_current"] = "link_side"  # what the next three add to
    rotor_inertia_sigma_kg_m2: float = 0.0  # drawn once per joint and seed
    ripple_sigma_nm: float = 0.0  # of both amplitudes of each ripple, likewise
    ripple_periods: tuple[float, ...] = ()  # in a turn of the joint
    torque_range_nm: float = 327.0  # beyond it the node reports an overload
    torque_hysteresis_ratio: float = 0.0  # largest error over the rated torque
    torque_noise: BandLimitedWhiteNoise | None = None  # instead of torque_noise_nm
    position_noise: BandLimitedWhiteNoise | None = None  # instead of encoder_noise_rad
    encoder_bits: int = 24
    encoder_noise_rad: float = 0.0
    speed_noise_rad_s: float = 0.0  # 1 sigma of one sample of a speed encoder
    start_sigma_rad: float = 2e-3  # 1 sigma of the start angle in the flight configuration
    latch_offset_s: float = 0.0  # latch instant minus the SYNC stamp
    rated_torque_nm: float = 40.0
    heartbeat_s: float = 1.0
    autostart: bool = True  # nodes become operational at the first SYNC without a command
    sync_counter_max: int = 240
    sync_rate_hz: float | None = None  # the plant produces SYNC at this rate; null: the host
    redundancy: BusToggleConfig | None = None  # null: one bus
    feed: FeedConfig | None = None  # the joints are on no CAN bus; null: they are nodes
    dialect: str | None = None  # of hil.devices.dialects; null: the tailored format
    nodes: tuple[NodeConfig, ...] = ()  # empty: nodes 0x11, 0x12, ..., classic, bus "arm"


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuSensorConfig:
    """Inertial unit: noise, mounting and time behaviour."""

    __pydantic_config__ = STRICT
    _angles = model_validator(mode="before")(_with_quaternion)
    p_BS_m: Vector3
    q_BS_xyzw: Quaternion
    angle_random_walk_rad_sqrt_s: float
    velocity_random_walk_m_s_sqrt_s: float
    gyro_bias_sigma_rad_s: float
    acc_bias_sigma_m_s2: float
    noise_correlation_s: float = 0.0  # of both; correlation falls by e in this time; 0: white
    gyro_bias_walk_rad_s_sqrt_s: float = 0.0  # rate random walk
    acc_bias_walk_m_s2_sqrt_s: float = 0.0
    gyro_bias_S_rad_s: Vector3 = (0.0, 0.0, 0.0)  # added to the drawn bias
    acc_bias_S_m_s2: Vector3 = (0.0, 0.0, 0.0)  # likewise
    gyro_matrix: tuple[Vector3, Vector3, Vector3] = EYE  # the rate of a reading without bias
    rate_hz: int = 500
    baud_rate: int = 921600
    device: str = "stim300"  # module of its wire format, in hil.devices unless a path
    device_options: Mapping[str, Any] = field(default_factory=dict)  # settings of that device
    datagram_id: int = 0xA5
    crlf: bool = False
    acc_range_g: Literal[5, 10, 30, 80] = 10
    acceleration: Literal["specific_force", "kinematic"] = "specific_force"
    gyro_noise: BandLimitedWhiteNoise | None = None  # instead of the angle random walk
    acc_noise: BandLimitedWhiteNoise | None = None  # instead of the velocity random walk
    gyro_group_delay_s: float = 2.2e-3
    acc_group_delay_s: float = 6.3e-3
    latency_s: float = 3.0e-4  # sample instant to first bit
    latency_jitter_s: float = 3.0e-5  # uniform, added to latency_s; the latency field has the sum
    clock_error_ppm: float = 50.0  # bound of the uniform draw
    startup_s: float = 0.0  # the start-up flag is set for this time after power-on
    chunking: Chunking = "datagram"
    chunk_clock_ppm: float = 500.0  # bound of the ms1 frame clock's error; default of a USB host


@dataclass(frozen=True, slots=True, kw_only=True)
class StarTrackerSensorConfig:
    """Star tracker: noise about its axes (boresight z) and time behaviour."""

    __pydantic_config__ = STRICT
    _angles = model_validator(mode="before")(_with_quaternion)
    p_BS_m: Vector3 = (0.0, 0.0, 0.0)
    q_BS_xyzw: Quaternion
    noise_across_rad: float = math.radians(2.0 / 3600.0)
    noise_about_rad: float = math.radians(10.0 / 3600.0)
    attitude_noise: BandLimitedWhiteNoise | None = None  # instead of both noises
    rate_hz: float = 5.0
    baud_rate: int = 115200
    latency_s: float = 0.1  # mid-exposure to the last byte of an unescaped frame
    latency_jitter_s: float = 0.0  # uniform, added to latency_s
    stamp_offset_s: float = 0.0  # the unit's time stamp minus mid-exposure
    clock_error_ppm: float = 0.0  # bound of the uniform draw
    unix_epoch_s: float = 1.8e9  # the unit's Unix time at power-on
    rotation: Literal["inertial_to_tracker", "tracker_to_inertial"] = "inertial_to_tracker"
    subscribed: bool = False  # sends solutions without a request
    chunking: Chunking = "datagram"
    chunk_clock_ppm: float = 500.0  # bound of the ms1 frame clock's error; default of a USB host


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
    torque_used: bool = False  # the flight side uses the motor torques


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
        return _adapter().validate_python(data)


@lru_cache(maxsize=1)
def _adapter() -> TypeAdapter[SensorConfig]:
    """Return the adapter of the sensors; to make it takes 30 ms."""
    return TypeAdapter(SensorConfig)
