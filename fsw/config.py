"""The configuration: one pydantic schema, YAML in, `ConfigError` out.

Every key with a dimension ends in its unit. Nothing about geometry or noise has a default. Paths
are relative to the configuration file. Reading a configuration touches no device.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Annotated, Literal, Self

import yaml
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    field_validator,
    model_validator,
)

from fsw.config_text import explain, read_yaml
from fsw.constants import EARTH_GRAVITY_PARAMETER_M3_S2
from fsw.errors import ConfigError

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]
PositiveVector3 = tuple[Positive, Positive, Positive]
Vector6 = tuple[Finite, Finite, Finite, Finite, Finite, Finite]
PositiveVector6 = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
Quaternion = tuple[Finite, Finite, Finite, Finite]
BodyName = Literal["base", "target"]


class Section(BaseModel):
    """Strictness shared by every section: no unknown keys, nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class RobotConfig(Section):
    """The known arm: a URDF whose root link is the base, and the frame that grasps."""

    urdf: Path
    tool_frame: str


class BodySigma(Section):
    """1-sigma of a body's prior: mass, centre of mass, inertia (xx xy xz yy yz zz)."""

    mass_kg: Positive
    com_m: PositiveVector3
    inertia_kg_m2: PositiveVector6


class BodyConfig(Section):
    """Inertial data of a body in its own frame, inertia about its centre of mass."""

    mass_kg: Positive
    com_m: Vector3
    inertia_kg_m2: Vector6
    sigma: BodySigma | None = None

    @model_validator(mode="after")
    def _physical(self) -> Self:
        import numpy as np

        xx, xy, xz, yy, yz, zz = self.inertia_kg_m2
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if moments[0] <= 0 or moments[0] + moments[1] < moments[2]:
            raise ValueError(
                f"inertia_kg_m2 {list(self.inertia_kg_m2)} is not physically possible: its "
                f"principal moments {moments.round(6).tolist()} must be positive and each at most "
                "the sum of the other two"
            )
        return self


class BusConfig(Section):
    """One CAN bus. `name` is also the recording's topic: /can/<name>."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_]+$")]
    interface: str  # any python-can interface: socketcan, udp_multicast, slcan, virtual ...
    channel: str
    fd: bool = False
    bitrate: int | None = Field(default=None, gt=0)
    data_bitrate: int | None = Field(default=None, gt=0)
    port: int | None = Field(default=None, ge=1, le=65535)  # udp_multicast only
    sync: Literal["producer", "consumer"] = "producer"
    rate_hz: Positive
    sync_counter_max: int = Field(default=240, ge=2, le=240)
    latch_offset_s: Finite = 0.0  # time of validity minus SYNC stamp


class JointConfig(Section):
    """One joint node. `name` is the joint's name in the URDF."""

    name: str
    driver: Literal["canopen"] = "canopen"
    bus: str
    node_id: int = Field(ge=1, le=127)
    format: Literal["classic", "fd"] = "classic"
    sign: Literal[-1, 1] = 1
    zero_offset_rad: Finite = 0.0
    torque_gain: Positive = 1.0
    torque_offset_nm: Finite = 0.0
    torque_limit_nm: Positive  # larger readings are rejected as out of range
    speed_limit_rad_s: Positive  # faster jumps between samples are rejected as out of range
    torque_noise_nm: Positive  # 1 sigma of one sample, white
    torque_offset_sigma_nm: NonNegative  # prior of the unknown offset; 0: none estimated
    torque_scale_sigma_ratio: NonNegative = 0.0  # prior of the scale error; 0: none estimated
    position_noise_rad: Positive  # 1 sigma of one sample, quantisation included


class Mounting(Section):
    """Pose of a sensor on the base: origin in B, and the quaternion taking S components to B."""

    p_BS_m: Vector3
    q_BS_xyzw: Quaternion

    @field_validator("q_BS_xyzw")
    @classmethod
    def _unit(cls, q: Quaternion) -> Quaternion:
        norm = sum(x * x for x in q) ** 0.5
        if abs(norm - 1.0) > 1e-6:
            raise ValueError(f"q_BS_xyzw {list(q)} has norm {norm:.9g}; must be 1 within 1e-6")
        return q


class ImuConfig(Section):
    """The inertial unit. Noise is white: angle and velocity random walk (sigma = N sqrt(rate))."""

    driver: Literal["stim300", "mip"] = "stim300"
    port: str
    baud_rate: int = Field(default=921600, gt=0)
    rate_hz: Positive
    crlf: bool = False  # datagrams are followed by CR LF
    acc_range_g: Literal[5, 10, 30, 80] = 10
    mounting: Mounting
    gyro_group_delay_s: NonNegative
    acc_group_delay_s: NonNegative
    angle_random_walk_rad_sqrt_s: Positive
    velocity_random_walk_m_s_sqrt_s: Positive
    gyro_bias_sigma_rad_s: NonNegative  # prior of the unknown bias; 0: none estimated
    acc_bias_sigma_m_s2: NonNegative
    max_rate_rad_s: Positive = 6.98  # larger readings are rejected as out of range (400 deg/s)
    clock_tolerance_ppm: Positive = 200.0


class StarTrackerConfig(Section):
    """The star tracker. `rotation` says which way its quaternion turns (a fact to confirm)."""

    driver: Literal["sagitta"] = "sagitta"
    port: str
    baud_rate: int = Field(default=115200, gt=0)
    rate_hz: Positive
    mounting: Mounting
    time: Literal["unit", "arrival"] = "arrival"  # its own time stamp, or arrival less latency
    latency_s: NonNegative  # from mid-exposure to the unit's time stamp, or to the last byte
    rotation: Literal["inertial_to_tracker", "tracker_to_inertial"] = "inertial_to_tracker"
    noise_across_rad: Positive
    noise_about_rad: Positive
    subscribe: bool = True  # ask the unit for asynchronous solutions at start


class SchedulerConfig(Section):
    """The loop's grid."""

    tick_rate_hz: Positive
    realtime_priority: int = Field(default=50, ge=0, le=99)  # 0: no SCHED_FIFO
    cpu: int | None = Field(default=None, ge=0)


class EstimatorConfig(Section):
    """Method, windows and gates."""

    method: Literal["mrnea", "rda", "cm", "fused"] = "fused"
    weighting: Literal["ols", "wls", "bc", "eiv"] = "eiv"  # of mrnea
    window_s: Positive = 0.4
    nodes: int = Field(default=4, ge=2, le=8)
    lag_s: NonNegative = 0.15  # a window closes this long after its end: the slowest sensor's delay
    store_blocks: int = Field(default=256, ge=4, le=100_000)
    settle_blocks: int = Field(default=25, ge=1)  # nothing is published as valid before this many
    min_fill_ratio: float = Field(default=0.6, gt=0, le=1)  # of the expected samples in a window
    wrench_force_sigma_n: Positive = 1e-3  # unmodelled external force
    wrench_torque_sigma_nm: Positive = 1e-3
    momentum_sigma_nms: NonNegative = 0.0  # prior of a residual angular momentum; 0: none estimated
    external_force_sigma_n: NonNegative = 0.0  # prior of a constant external wrench at the base's
    external_torque_sigma_nm: NonNegative = 0.0  # origin, inertial axes; 0: none estimated
    gate_probability: float = Field(default=1e-6, gt=0, lt=0.1)  # false-alarm rate of the NIS gate
    condition_limit: Positive = 1e8
    forgetting_time_s: Positive | None = None  # data's information decays with it; null: never


class OrbitConfig(Section):
    """A circular orbit: turns on gravity-gradient force and torque. Needs a star tracker.

    State of the system's centre of mass from the Earth's centre, in inertial axes, at the epoch.
    """

    position_m: Vector3
    velocity_m_s: Vector3
    epoch_ns: int | None = None  # on the daemon's clock; null: the first SYNC
    gravity_parameter_m3_s2: Positive = EARTH_GRAVITY_PARAMETER_M3_S2

    @model_validator(mode="after")
    def _circular(self) -> Self:
        radius = sum(x * x for x in self.position_m) ** 0.5
        speed = sum(v * v for v in self.velocity_m_s) ** 0.5
        circular = (self.gravity_parameter_m3_s2 / radius) ** 0.5 if radius > 0 else 0.0
        along = sum(x * v for x, v in zip(self.position_m, self.velocity_m_s, strict=True))
        if not (abs(speed - circular) <= 0.02 * circular and abs(along) <= 0.02 * radius * speed):
            raise ValueError(
                f"velocity_m_s {list(self.velocity_m_s)} must be across position_m and within 2 % "
                f"of the circular {circular:.1f} m/s"
            )
        return self


class RecorderConfig(Section):
    """Where recordings go; null directory: none."""

    directory: Path | None = None
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    chunk_bytes: int = Field(default=65536, ge=4096)


class ServiceConfig(Section):
    """Local state of the daemon: status file, control socket, checkpoints."""

    state_directory: Path
    status_rate_hz: Positive = 5.0


class Config(Section):
    """The whole configuration of one daemon."""

    robot: RobotConfig
    bodies: dict[BodyName, BodyConfig] = Field(default_factory=dict)
    unknown: Annotated[tuple[BodyName, ...], Field(min_length=1)]
    buses: Annotated[tuple[BusConfig, ...], Field(min_length=1)]
    joints: Annotated[tuple[JointConfig, ...], Field(min_length=1)]
    imu: ImuConfig
    star_tracker: StarTrackerConfig | None = None
    orbit: OrbitConfig | None = None
    scheduler: SchedulerConfig
    estimator: EstimatorConfig = EstimatorConfig()
    recorder: RecorderConfig = RecorderConfig()
    service: ServiceConfig

    _source: bytes = PrivateAttr(default=b"")
    _folder: Path = PrivateAttr(default=Path())
    _name: str = PrivateAttr(default="configuration")

    def read_from(self, source: bytes, folder: Path, name: str) -> Self:
        """Remember text, folder and file name this configuration came from."""
        self._source, self._folder, self._name = source, folder, name
        return self

    @property
    def crc32(self) -> int:
        """CRC-32 of the file the configuration was read from."""
        return zlib.crc32(self._source)

    @property
    def name(self) -> str:
        """What messages call this configuration: its file."""
        return self._name

    @property
    def source(self) -> bytes:
        """The text the configuration was read from."""
        return self._source

    def resolve(self, path: Path) -> Path:
        """Return a path of the configuration, relative ones taken from its folder."""
        return path if path.is_absolute() else self._folder / path

    def with_unknown(self, unknown: tuple[str, ...]) -> Self:
        """Return this configuration for other unknown bodies.

        Raises
        ------
        ConfigError if one of them has no prior.
        """
        data = self.model_dump() | {"unknown": unknown}
        try:
            changed = type(self).model_validate(data)
        except ValidationError as error:
            raise ConfigError("\n".join(explain(type(self), error))) from error
        return changed.read_from(self._source, self._folder, self._name)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        _unique([b.name for b in self.buses], "buses.name")
        _unique([j.name for j in self.joints], "joints.name")
        _unique([f"{j.bus}:{j.node_id}" for j in self.joints], "joints.node_id")
        ports = {"imu.port": self.imu.port}
        if self.star_tracker:
            ports["star_tracker.port"] = self.star_tracker.port
        for i, bus in enumerate(self.buses):
            link = bus.channel if bus.port is None else f"{bus.channel}:{bus.port}"
            ports[f"buses.{i}.channel"] = f"{bus.interface}:{link}"
        _one_device_each(ports)
        _unique(list(self.unknown), "unknown")
        if self.orbit is not None and self.star_tracker is None:
            raise ValueError(
                "orbit: needs a star_tracker; the gravity gradient turns with attitude"
            )
        names = {b.name: b for b in self.buses}
        for i, joint in enumerate(self.joints):
            if joint.bus not in names:
                raise ValueError(
                    f"joints.{i}.bus: {joint.bus!r} is none of the buses {sorted(names)}"
                )
            if joint.format == "fd" and not names[joint.bus].fd:
                raise ValueError(f"joints.{i}.format: 'fd' needs buses.{joint.bus}.fd: true")
        for body in self.unknown:
            if body not in self.bodies:
                raise ValueError(
                    f"bodies.{body}: missing; unknown lists {body!r}, which needs a prior"
                )
            if self.bodies[body].sigma is None:
                raise ValueError(f"bodies.{body}.sigma: missing; unknown lists {body!r}")
        for i, bus in enumerate(self.buses):
            ratio = self.scheduler.tick_rate_hz / bus.rate_hz
            if abs(ratio - round(ratio)) > 1e-9 or ratio < 1:
                raise ValueError(
                    f"buses.{i}.rate_hz: {bus.rate_hz} must divide scheduler.tick_rate_hz "
                    f"{self.scheduler.tick_rate_hz}"
                )
        return self


def _unique(values: list[str], key: str) -> None:
    for value in values:
        if values.count(value) > 1:
            times = values.count(value)
            raise ValueError(f"{key}: {value!r} is used {times} times; must be unique")


def _one_device_each(ports: dict[str, str]) -> None:
    for port in ports.values():
        keys = [other for other, used in ports.items() if used == port]
        if len(keys) > 1:
            raise ValueError(
                f"{' and '.join(keys)}: all name {port!r}; a port serves one device only"
            )


def load(path: Path) -> Config:
    """Read and validate a configuration file.

    Raises
    ------
    ConfigError with one line per fault: key, value, bound.
    """
    try:
        source = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    return parse(source, path.parent, str(path))


def parse(source: bytes, folder: Path, name: str) -> Config:
    """Validate configuration text; relative paths are taken from `folder`.

    Raises
    ------
    ConfigError with one line per fault: key, value, bound.
    """
    try:
        data = read_yaml(source)
    except (yaml.YAMLError, ValueError) as error:  # ValueError: an impossible date or number
        raise ConfigError(f"{name}: not YAML: {error}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{name}: must be a mapping of sections; found {type(data).__name__}")
    try:
        config = Config.model_validate(data)
    except ValidationError as error:
        lines = [f"{name}: {line}" for line in explain(Config, error)]
        raise ConfigError("\n".join(lines)) from error
    return config.read_from(source, folder.absolute(), name)
