"""The whole configuration of one daemon: sections, conditions between sections, reading."""

import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Self

from pydantic import ConfigDict, Field, PrivateAttr, ValidationError, model_validator

from fsw.config.actuators import ACTUATORS, Actuator
from fsw.config.base import BodyName, Section, allow_null, null_is_left_out
from fsw.config.buses import BusConfig
from fsw.config.consistency import (
    base_goes_with,
    bodies_have_their_keys,
    delays_fit,
    method_has_its_torques,
    redundancy_works,
    require_one_device_each,
    require_unique,
)
from fsw.config.described import devices_go_with
from fsw.config.feed_devices import feeds_go_with
from fsw.config.health import HealthConfig
from fsw.config.joints import JointConfig
from fsw.config.modes import ModeConfig, modes_go_with
from fsw.config.processing import (
    EstimatorConfig,
    OrbitConfig,
    SchedulerConfig,
    for_short_recordings,
)
from fsw.config.robot import BaseConfig, BodyConfig, RobotConfig
from fsw.config.sensors import ImuConfig, StarTrackerConfig, no_imu
from fsw.config.services import (
    ExcitationConfig,
    RecorderConfig,
    ServiceConfig,
    reserve_holds_chunks,
)
from fsw.config.signals import DESCRIBED
from fsw.config.telemetry import TelemetryConfig
from fsw.config.text import (
    CONFIGURATION,
    RECORDING,
    TextError,
    explain,
    kind_of,
    no_sections,
    read_yaml,
)
from fsw.config.thrusters import ThrusterConfig, thrusters_go_with
from fsw.config.wheels import WheelConfig
from fsw.config.wrench_sensors import WrenchSensorConfig, wrench_sensors_go_with
from fsw.errors import ConfigError

BusDevice = JointConfig | ImuConfig | StarTrackerConfig | Actuator
BETWEEN_FILES = " + "  # in the name of a configuration with overlays


class Config(Section):
    """The whole configuration of one daemon."""

    model_config = ConfigDict(json_schema_extra=allow_null)

    robot: RobotConfig
    base: BaseConfig = BaseConfig()
    bodies: dict[BodyName, BodyConfig] = Field(default_factory=dict)
    unknown: Annotated[tuple[BodyName, ...], Field(min_length=1)]
    """what is to be identified; each needs `bodies.NAME` with `sigma`. Telemetry packets and the
    live page show `base` and `target`; the recording and `fsw replay`, `identify` show all"""
    buses: tuple[BusConfig, ...] = ()
    joints: tuple[JointConfig, ...] = ()
    wrench_sensors: Annotated[tuple[WrenchSensorConfig, ...], Field(max_length=4)] = ()
    wheels: Annotated[tuple[WheelConfig, ...], Field(max_length=16)] = ()
    thrusters: Annotated[tuple[ThrusterConfig, ...], Field(max_length=24)] = ()
    modes: Annotated[tuple[ModeConfig, ...], Field(max_length=8)] = ()
    imu: ImuConfig = Field(default_factory=no_imu)
    star_tracker: StarTrackerConfig | None = None
    orbit: OrbitConfig | None = None
    scheduler: SchedulerConfig
    estimator: EstimatorConfig = EstimatorConfig()
    health: HealthConfig = HealthConfig()
    recorder: RecorderConfig = RecorderConfig()
    service: ServiceConfig = ServiceConfig()
    excitation: ExcitationConfig | None = None
    telemetry: TelemetryConfig | None = None

    _source: bytes = PrivateAttr(default=b"")
    _folder: Path = PrivateAttr(default=Path())
    _files: tuple[str, ...] = PrivateAttr(default=("configuration",))

    def read_from(self, source: bytes, folder: Path, *files: str) -> Self:
        """Store the text, its folder, and the files that it is from; return `self`."""
        self._source, self._folder, self._files = source, folder, files
        return self

    @property
    def crc32(self) -> int:
        """CRC-32 of `source`."""
        return zlib.crc32(self._source)

    @property
    def name(self) -> str:
        """Name of this configuration in messages: the paths of its files."""
        return BETWEEN_FILES.join(self._files)

    @property
    def files(self) -> tuple[str, ...]:
        """Path of the configuration's file, then those of its overlays."""
        return self._files

    @property
    def source(self) -> bytes:
        """The YAML text from which the configuration was read."""
        return self._source

    @property
    def can_nodes(self) -> tuple[BusDevice, ...]:
        """All CAN nodes: joints, wheels, one thruster of each node with valves, sensors."""
        nodes = {f"{thruster.bus}:{thruster.node_id}": thruster for thruster in self.thrusters}
        devices = (*self.joints, *self.wheels, *nodes.values(), *self.sensors)
        return tuple(own for own in devices if own.node_id is not None)

    @property
    def bus_devices(self) -> dict[str, BusDevice]:
        """All devices that have a key `bus`, by the place of each."""
        parts: dict[str, BusDevice] = {own.name: own for own in self.sensors}
        for key in ("joints", *ACTUATORS):
            parts |= {f"{key}.{i}": part for i, part in enumerate(getattr(self, key))}
        return parts

    @property
    def sensors(self) -> tuple[ImuConfig | StarTrackerConfig, ...]:
        """Inertial unit and star tracker that the robot has."""
        imu = (self.imu,) if self.imu.present else ()
        return imu if self.star_tracker is None else (*imu, self.star_tracker)

    @property
    def actuators(self) -> dict[str, tuple[Actuator, ...]]:
        """All actuators of the base, by section; no empty ones."""
        return {section: own for section in ACTUATORS if (own := getattr(self, section))}

    @property
    def devices(self) -> dict[str, tuple[Actuator | WrenchSensorConfig, ...]]:
        """All devices with channels of their own besides joints, by section; no empty ones."""
        own = {"wrench_sensors": self.wrench_sensors} if self.wrench_sensors else {}
        return {**self.actuators, **own}

    def as_read(self) -> Self:
        """Return the configuration that `source` states, without later changes."""
        if not self._source:
            return self
        data = read_yaml(self._source, aliases=True)
        return type(self).model_validate(data).read_from(self._source, self._folder, *self._files)

    def resolve(self, path: Path) -> Path:
        """Return a path of the configuration; a relative path starts at the file's folder."""
        return path if path.is_absolute() else self._folder / path

    @property
    def line_ports(self) -> dict[str, str | None]:
        """Serial ports by their keys; a device on a bus or feed has none."""
        return {f"{own.name}.port": own.port for own in self.sensors if not own.bus}

    def missing_ports(self) -> list[str]:
        """Return missing keys of devices, which a live run needs and a replay does not."""
        keys = self.line_ports
        for i, bus in enumerate(self.buses):
            keys[f"buses.{i}.interface"], keys[f"buses.{i}.channel"] = bus.interface, bus.channel
        return [key for key, value in keys.items() if value is None]

    def device(self, port: str | None) -> str:
        """Return a serial port as it is opened: an unchanged URL, or a resolved path.

        Raises
        ------
        ConfigError if `port` is None.
        """
        if port is None:
            raise ConfigError(f"{self.name}: a serial device without a port")
        return port if "://" in port else str(self.resolve(Path(port)))

    def feed_place(self, bus: BusConfig) -> Path | tuple[str, int]:
        """Return where a feed is received: the path of a Unix socket, or address and port.

        Raises
        ------
        ConfigError if the bus has no channel.
        """
        if bus.channel is None:
            raise ConfigError(f"{self.name}: buses: {bus.name!r} without a channel")
        return self.resolve(Path(bus.channel)) if bus.port is None else (bus.channel, bus.port)

    def with_unknown(self, unknown: tuple[str, ...]) -> Self:
        """Return this configuration with other unknown bodies.

        Raises
        ------
        ConfigError if a body has no prior.
        """
        return self.with_sections(unknown=unknown)

    def with_sections(self, **sections: object) -> Self:
        """Return this configuration with other sections, validated as a whole.

        Raises
        ------
        ConfigError with one line per fault.
        """
        data = self.model_dump() | sections
        try:
            changed = type(self).model_validate(data)
        except ValidationError as error:
            raise ConfigError("\n".join(explain(type(self), error))) from error
        return changed.read_from(self._source, self._folder, *self._files)

    @model_validator(mode="before")
    @classmethod
    def _without_null(cls, data: object) -> object:
        return for_short_recordings(null_is_left_out(cls, data))

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        _something_turns(self)
        _parts_are_unique(self)
        ports = self.line_ports
        for i, bus in enumerate(self.buses):
            ports[f"buses.{i}.channel"] = _device(bus)
            second = bus.second()
            if second is not None:
                ports[f"buses.{i}.redundant.channel"] = _device(second)
                redundancy_works(i, bus)
        require_one_device_each({key: port for key, port in ports.items() if port is not None})
        require_unique(list(self.unknown), "unknown")
        reserve_holds_chunks(self.recorder, self.service)
        if self.orbit is not None and self.star_tracker is None:
            raise ValueError(
                "orbit: needs a star_tracker; the gravity gradient turns with attitude"
            )
        devices_go_with(self.buses, self.bus_devices)
        feeds_go_with(self.buses, self.bus_devices)
        wrench_sensors_go_with(self.wrench_sensors, self.estimator.method)
        thrusters_go_with(
            self.thrusters,
            attitude=self.star_tracker is not None,
            base_motion=self.base.motion,
        )
        if self.estimator.outside_wrench == "watch":
            free = self.base.motion == "free" and self.star_tracker is not None
            if not free or self.estimator.method != "fused":
                raise ValueError(
                    "estimator.outside_wrench: 'watch' needs method fused, base.motion: free and a "
                    f"star_tracker; found method {self.estimator.method}, base.motion: "
                    f"{self.base.motion}, {'a' if self.star_tracker else 'no'} star_tracker"
                )
        method_has_its_torques(self.estimator.method, self.joints)
        _speeds_are_enough(self)
        if not self.imu.present and self.base.motion != "clamped":
            raise ValueError("imu: missing; only a clamped base does without an inertial unit")
        base_goes_with(self.base, self.unknown, self.estimator, orbit=self.orbit is not None)
        modes_go_with(self.modes, self.joints, self.estimator, self.base.motion)
        bodies_have_their_keys(self.bodies, self.unknown)
        delays_fit(self.joints, self.buses, self.imu, self.estimator.window_s)
        for i, bus in enumerate(self.buses):
            ratio = self.scheduler.tick_rate_hz / bus.rate_hz
            if bus.feed is None and (abs(ratio - round(ratio)) > 1e-9 or ratio < 1):
                raise ValueError(
                    f"buses.{i}.rate_hz: {bus.rate_hz} must divide scheduler.tick_rate_hz "
                    f"{self.scheduler.tick_rate_hz}"
                )
        return self


def _parts_are_unique(config: Config) -> None:
    """Raise ValueError if parts share a name or a node, or thrusters a valve of their node.

    Described devices may share a node, as axes of one drive do, but not a tailored one.
    """
    for section in ("buses", "joints", *ACTUATORS, "modes"):
        require_unique([part.name for part in getattr(config, section)], f"{section}.name")
    names = [*(j.name for j in config.joints), *(own.name for own in config.wrench_sensors)]
    require_unique(names, "wrench_sensors.name")
    nodes = list(dict.fromkeys(map(_node, _numbered(config.bus_devices.values(), DESCRIBED))))
    for section in ("joints", *ACTUATORS):
        own = [_node(part) for part in _numbered(getattr(config, section), "canopen")]
        nodes += dict.fromkeys(own) if section == "thrusters" else own
        require_unique(nodes, f"{section}.node_id")
    valves = [
        f"{_node(own)} valve {own.valve}" for own in config.thrusters if own.driver == "canopen"
    ]
    require_unique(valves, "thrusters.valve")


def _numbered(devices: Iterable[BusDevice], driver: str) -> list[BusDevice]:
    """Return the devices of a driver that have a number."""
    return [own for own in devices if own.driver == driver and own.node_id is not None]


def _node(own: BusDevice) -> str:
    return f"{own.bus}:0x{own.node_id:02x}"


def _something_turns(config: Config) -> None:
    """Raise ValueError for a robot without joints unless it has wheels, a free base and mrnea."""
    if config.joints:
        return
    if not config.wheels:
        raise ValueError("joints: missing; only a body with reaction wheels does without")
    if config.base.motion != "free":
        raise ValueError(f"joints: missing; base.motion {config.base.motion} needs some")
    if config.estimator.method != "mrnea":
        raise ValueError(
            f"estimator.method: {config.estimator.method!r} needs joints; a body with reaction "
            "wheels alone has mrnea"
        )


def _device(bus: BusConfig) -> str | None:
    if bus.interface is None or bus.channel is None:
        return None
    link = bus.channel if bus.port is None else f"{bus.channel}:{bus.port}"
    return f"{bus.interface}:{link}"


def _speeds_are_enough(config: Config) -> None:
    """Raise ValueError for settings that need measured angles if an encoder measures speed only."""
    name = next((joint.name for joint in config.joints if joint.speed_only), None)
    if name is None:
        return
    estimator = config.estimator
    if estimator.method == "mrnea":
        raise ValueError(
            f"estimator.method: 'mrnea' needs the position of every joint; {name!r} has encoder: "
            "speed; must be fused, rda or cm"
        )
    sums = {
        "orbit": config.orbit is not None,
        "thrusters": bool(config.thrusters),
        "modes": bool(config.modes),
        "joints[].angle_scale_sigma_ratio": any(j.angle_scale_sigma_ratio for j in config.joints),
        "estimator.outside_wrench": estimator.outside_wrench == "watch",
        "estimator.external_force_sigma_n": estimator.external_force_sigma_n > 0.0,
        "estimator.external_torque_sigma_nm": estimator.external_torque_sigma_nm > 0.0,
        "estimator.target_force_sigma_n": estimator.target_force_sigma_n > 0.0,
        "estimator.target_torque_sigma_nm": estimator.target_torque_sigma_nm > 0.0,
    }
    for key, given in sums.items():
        if given:
            raise ValueError(f"{key}: is not known if {name!r} has encoder: speed; leave it out")


def load(path: Path) -> Config:
    """Read and validate a configuration file.

    Raises
    ------
    ConfigError with one line per fault, which names key, value and bound.
    """
    try:
        source = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    return parse(source, path.parent, str(path))


def parse(source: bytes, folder: Path, *files: str) -> Config:
    """Return the configuration in YAML text `source`; relative paths start at `folder`.

    `files` are those that the text is from.

    Raises
    ------
    ConfigError with one line per fault, which names key, value and bound.
    """
    name = BETWEEN_FILES.join(files)
    if (kind := kind_of(source)) not in ("", CONFIGURATION, RECORDING):
        raise ConfigError(f"{name}: is {kind}, not a configuration; fsw init URDF writes one")
    try:
        data = read_yaml(source, aliases=True)
    except TextError as error:
        raise ConfigError(f"{name}: {error}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{name}: {no_sections(data)}")
    try:
        config = Config.model_validate(data)
    except ValidationError as error:
        lines = [f"{name}: {line}" for line in explain(Config, error)]
        raise ConfigError("\n".join(lines)) from error
    return config.read_from(source, folder.absolute(), *files)
