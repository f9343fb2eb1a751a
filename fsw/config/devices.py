"""Sections of the devices: buses, joint nodes, inertial unit, star tracker."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import hypot, isfinite, sqrt, tau
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    SerializerFunctionWrapHandler,
    ValidationError,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from fsw.config.base import (
    AccelerationSigma,
    AngleNoise,
    AngleSigma,
    CorrelationTime,
    Delay,
    Duration,
    Finite,
    Gain,
    Length,
    Matrix3,
    Periods,
    Position,
    Positive,
    Quaternion,
    RandomWalk,
    Rate,
    RateSigma,
    RotorSigma,
    ScaleSigma,
    Section,
    SlowRate,
    SpeedNoise,
    TorqueNoise,
    TorqueSigma,
    Turn,
    Vector3,
)
from fsw.config.feed import FeedConfig, check_address
from fsw.config.signals import LayoutMessageConfig, Role, SignalConfig, TimingConfig
from fsw.errors import brief

MAX_ANGLE_RAD = tau  # of a mounting; larger angles are probably in degrees
MOST_GYRO_ERROR = 0.2  # of an entry of gyro_matrix; a larger error is a wrong unit or mounting
Driver = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.]+(:[A-Za-z0-9_.]+)?$", max_length=200)]
NONE = "none"  # stands for a device that the robot does not have
SAMPLES = "samples"  # values that another program decoded: of a feed, or in recordings only
LINES = ("imu", "star_tracker")


class RedundantBusConfig(Section):
    """The second bus of a redundant pair; nodes use one bus at a time (ECSS-E-ST-50-15C)."""

    channel: str
    port: int | None = Field(default=None, ge=1, le=65535)  # for udp_multicast and udp_frames
    lost_after_s: Duration = 0.3  # the active bus is lost if no node sends for this time
    nodes_toggle_s: Duration  # Ttoggle times the nodes' consumer heartbeat time


class BusConfig(Section):
    """One CAN bus. `name` is also the recording's topic: /can/<name>."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_]+$")]
    interface: str | None = None  # samples, or one of python-can: socketcan, udp_multicast ...
    feed: FeedConfig | None = None  # of interface samples: who sends them live; None: recordings
    channel: str | None = None  # a replay needs neither interface nor channel
    description: Path | None = None  # DBC, KCD, SYM or ARXML of foreign devices on the bus
    messages: Annotated[tuple[LayoutMessageConfig, ...], Field(max_length=256)] = ()
    listen_only: bool = False  # another master runs the bus: the daemon never sends a frame
    fd: bool = False
    bitrate: int | None = Field(default=None, gt=0)
    data_bitrate: int | None = Field(default=None, gt=0)
    port: int | None = Field(default=None, ge=1, le=65535)  # for a feed and CAN over UDP
    sync: Literal["producer", "consumer", "none"] = "producer"  # none: nobody sends SYNC
    rate_hz: Rate  # of SYNC; of the joints' samples
    sync_counter_max: Annotated[int, Field(ge=0, le=240)] = 240  # 0: SYNC has no data
    latch_offset_s: Finite = 0.0  # time of validity of joint samples minus SYNC stamp
    heartbeat_s: Duration | None = None  # period of the computer's heartbeat; None: none is sent
    redundant: RedundantBusConfig | None = None

    @model_validator(mode="after")
    def _feed_works(self) -> Self:
        """Refuse a feed that cannot be received, and keys of CAN beside it."""
        if self.feed is None:
            return self
        if self.interface != SAMPLES:
            raise ValueError(f"interface: {self.interface!r} with feed; must be {SAMPLES!r}")
        if self.name in LINES:
            raise ValueError(f"name: {self.name!r} is a serial line; a feed needs another name")
        for key in ("redundant", "heartbeat_s"):
            if getattr(self, key) is not None:
                raise ValueError(f"{key}: a feed has none; must be left out")
        check_address(self.feed, self.channel, self.port)
        return self

    @model_validator(mode="after")
    def _only_listens(self) -> Self:
        """Refuse keys that would make a daemon send that may only listen."""
        if self.sync_counter_max == 1:
            raise ValueError("sync_counter_max: 1; must be 0 or 2 to 240")
        if self.listen_only and self.sync == "producer":
            raise ValueError("sync: 'producer' with listen_only; must be consumer or none")
        if self.listen_only and self.heartbeat_s is not None:
            raise ValueError(f"heartbeat_s: {self.heartbeat_s:g} with listen_only; leave it out")
        return self

    def second(self) -> BusConfig | None:
        """Return the configuration of the redundant bus; None: there is none."""
        if self.redundant is None:
            return None
        changes = {"channel": self.redundant.channel, "port": self.redundant.port}
        return self.model_copy(update=changes)


TORQUE_STEP_NM = {"classic": 1e-2, "fd": 1e-4}  # resolution of a canopen node's torque, by format
WITHOUT_TORQUE = {  # values for a joint without torque sensor: the noise makes torque useless
    "torque_limit_nm": 1e4,
    "torque_noise_nm": 1e4,
    "torque_offset_sigma_nm": 0.0,
    "torque_scale_sigma_ratio": 0.0,
    "friction_coulomb_sigma_nm": 0.0,
    "friction_viscous_sigma_nms_rad": 0.0,
    "friction_load_sigma_ratio": 0.0,
    "rotor_inertia_sigma_kg_m2": 0.0,
    "ripple_sigma_nm": 0.0,
    "ripple_periods": (),
    "torque_model_sigma_nm": 0.0,
}
OF_MOTOR_CURRENT = {  # wide priors of what stands between motor and link, as shares of the limit
    "friction_coulomb_sigma_nm": 0.1,
    "friction_viscous_sigma_nms_rad": 0.1,
    "rotor_inertia_sigma_kg_m2": 0.02,
}
LOAD_OF_CURRENT = 0.1  # 1 sigma of the share of the transmitted torque that is friction
GAIN_OF_CURRENT = 0.1  # 1 sigma of torque constant times gear ratio times efficiency


WITHOUT_POSITION = {"position_noise_rad": 1e-5}  # value for an encoder that measures speed only


def _keys_of_a_joint(schema: dict[str, Any]) -> None:
    """Add to a JSON schema the keys that a joint of each kind, with each sensor, requires."""
    required: list[str] = schema["required"]
    optional = (*WITHOUT_TORQUE, *WITHOUT_POSITION)

    def of(words: Callable[[str], str]) -> dict[str, Any]:
        def sensed(keys: Iterable[str]) -> dict[str, Any]:
            return {"required": [words(key) for key in keys]}

        def by(
            key: str, value: str, then: Iterable[str], otherwise: Iterable[str]
        ) -> dict[str, Any]:
            condition = {"properties": {words(key): {"const": value}}, "required": [words(key)]}
            return {"if": condition, "then": sensed(then), "else": sensed(otherwise)}

        return sensed(key for key in required if key not in optional) | {
            "allOf": [
                by("torque", "none", (), [key for key in required if key in WITHOUT_TORQUE]),
                by("encoder", "speed", ("speed_noise_rad_s",), WITHOUT_POSITION),
            ]
        }

    schema["properties"] |= {linear(key): value for key, value in schema["properties"].items()}
    schema["required"] = [key for key in required if linear(key) == key]
    schema["if"] = {"properties": {"kind": {"const": "prismatic"}}, "required": ["kind"]}
    schema |= {"then": of(linear), "else": of(str)}


class JointConfig(Section):
    """One joint node. `name` is the joint's name in the URDF."""

    model_config = ConfigDict(json_schema_extra=_keys_of_a_joint)

    name: str
    driver: Literal["canopen", "described", "samples"] = "canopen"  # samples: values of a feed
    bus: str
    node_id: Annotated[int, Field(ge=1, le=127)] | None = None  # of a CANopen node
    description: Path | None = None  # EDS or DCF of the node; null: the bus's description
    signals: dict[Role, SignalConfig] | None = None  # for driver: described
    timing: TimingConfig | None = None  # likewise
    format: Literal["classic", "fd"] = "classic"
    kind: Literal["revolute", "prismatic"] = "revolute"  # names of prismatic keys: see `linear`
    sign: Literal[-1, 1] = 1
    zero_offset_rad: Turn = 0.0
    torque: Literal["link_side", "motor_current", "none"] = (
        "link_side"  # motor_current: friction, rotor and gain are wide by default; none: no sensor
    )
    torque_gain: Gain = 1.0  # negative: the torque has the opposite sign, the angle does not
    torque_offset_nm: Finite = 0.0
    torque_limit_nm: Positive  # larger readings are rejected as out of range
    speed_limit_rad_s: Positive  # faster jumps between samples are rejected as out of range
    torque_noise_nm: TorqueNoise  # 1 sigma of one sample, white
    torque_offset_sigma_nm: TorqueSigma  # prior of the unknown offset; 0: none estimated
    torque_scale_sigma_ratio: ScaleSigma = 0.02  # prior of the scale error; 0: none estimated
    friction_coulomb_sigma_nm: TorqueSigma = 0.0  # prior of friction in the reading; 0: none
    friction_viscous_sigma_nms_rad: TorqueSigma = 0.0
    friction_load_sigma_ratio: ScaleSigma = 0.0  # of friction over the transmitted torque; 0: none
    friction_speed_rad_s: SlowRate = 0.01  # Coulomb friction is c tanh(rate / friction_speed)
    rotor_inertia_sigma_kg_m2: RotorSigma = 0.0  # of rotor and gear, seen at the link; 0: none
    ripple_periods: tuple[Periods, ...] = ()  # of the gear's ripple in a turn of the joint
    ripple_sigma_nm: TorqueSigma = 0.0  # prior of sine and cosine amplitude of each; 0: none
    torque_model_sigma_nm: TorqueSigma = 0.0  # 1 sigma of the model's error in the torque; 0: none
    torque_model_correlation_s: CorrelationTime = 0.1  # time in which that error decays by e
    encoder: Literal["position", "speed"] = "position"  # speed: the node measures no angle
    position_noise_rad: AngleNoise  # 1 sigma of one sample, including quantisation
    speed_noise_rad_s: SpeedNoise | None = None  # 1 sigma of one sample; for encoder: speed
    start_rad: Turn | None = None  # for encoder: speed, angle before the first sample; None: 0
    zero_sigma_rad: AngleSigma = 2e-3  # 1 sigma of zero_offset_rad or start_rad; 0: exact
    angle_scale_sigma_ratio: ScaleSigma = 0.0  # 1 sigma of the angle's scale; 0: exact
    link_sigma_ratio: ScaleSigma | None = None  # of the moved link; None: robot.links_sigma_ratio

    @model_validator(mode="after")
    def _driver_keys(self) -> Self:
        """Refuse a joint that lacks a key of its driver, or has a key of another one."""
        is_described = self.driver == "described"
        needs = {"signals": is_described, "timing": is_described}
        allows = needs | {"description": is_described, "node_id": self.driver != SAMPLES}
        needs["node_id"] = self.driver == "canopen" or self.description is not None
        for key, is_allowed in allows.items():
            value = getattr(self, key)
            if value is not None and not is_allowed:
                shown = brief(value) if key == "node_id" else "it"
                raise ValueError(f"{key}: {shown} must be left out with driver: {self.driver}")
            if value is None and needs.get(key, False):
                raise ValueError(f"{key}: missing with driver: {self.driver}")
        if self.signals is not None and self.timing is not None:
            self._roles_given(self.signals, self.timing)
        return self

    def _roles_given(self, signals: Mapping[Role, SignalConfig], timing: TimingConfig) -> None:
        needed: dict[Role, bool] = {
            "position": not self.speed_only,
            "speed": self.speed_only,
            "torque": self.torque != "none",
            "time": timing.by == "device_time",
            "counter": timing.by == "echoed_counter",
        }
        for role, is_needed in needed.items():
            if (role in signals) != is_needed:
                words = "missing" if is_needed else "has no use"
                raise ValueError(
                    f"signals.{role}: {words} with encoder {self.encoder}, torque {self.torque}, "
                    f"timing by {timing.by}"
                )
        for role, own in signals.items():
            for key in ("mask", "value"):
                if (getattr(own, key) is not None) != (role == "status"):
                    raise ValueError(f"signals.{role}.{key}: only, and always, of status")

    @model_validator(mode="before")
    @classmethod
    def _without_torque(cls, data: object) -> object:
        """Replace the keys of a torque sensor by WITHOUT_TORQUE if the joint has no sensor."""
        if isinstance(data, dict) and data.get("torque") == "none":
            return data | WITHOUT_TORQUE
        return data

    @model_validator(mode="before")
    @classmethod
    def _of_motor_current(cls, data: object) -> object:
        """Add wide priors of friction, rotor inertia and gain for a torque from motor current."""
        if not isinstance(data, dict) or data.get("torque") != "motor_current":
            return data
        limit = data.get("torque_limit_nm")
        if isinstance(limit, bool) or not isinstance(limit, int | float) or not limit > 0.0:
            return data  # the field's own check refuses it
        wide = {key: share * limit for key, share in OF_MOTOR_CURRENT.items()}
        wide["friction_load_sigma_ratio"] = LOAD_OF_CURRENT
        return wide | {"torque_scale_sigma_ratio": GAIN_OF_CURRENT} | data

    @model_validator(mode="after")
    def _ripple_keys(self) -> Self:
        """Refuse a ripple without amplitude, an amplitude without ripple, and that of a slide."""
        if bool(self.ripple_periods) != (self.ripple_sigma_nm > 0.0):
            raise ValueError(
                f"ripple_periods: {list(self.ripple_periods)} with ripple_sigma_nm "
                f"{self.ripple_sigma_nm:g}; must both be given, or none of them"
            )
        if self.ripple_periods and self.kind == "prismatic":
            raise ValueError("ripple_periods: of a prismatic joint; must be left out")
        if len(set(self.ripple_periods)) < len(self.ripple_periods):
            raise ValueError(f"ripple_periods: {list(self.ripple_periods)}; must be unique")
        return self

    @model_validator(mode="before")
    @classmethod
    def _without_position(cls, data: object) -> object:
        """Add WITHOUT_POSITION and start_rad for an encoder that measures speed only."""
        if not isinstance(data, dict) or data.get("encoder") != "speed":
            return data
        name = linear if data.get("kind") == "prismatic" else str
        if data.get("zero_offset_rad"):
            raise ValueError(
                f"{name('zero_offset_rad')}: {brief(data['zero_offset_rad'])} has no meaning with "
                f"encoder: speed; must be left out, see {name('start_rad')}"
            )
        if data.get("speed_noise_rad_s") is None:
            raise ValueError(f"{name('speed_noise_rad_s')}: missing; encoder: speed needs it")
        return data | WITHOUT_POSITION | {"start_rad": data.get("start_rad") or 0.0}

    @model_validator(mode="after")
    def _speed_keys(self) -> Self:
        """Refuse keys of a speed encoder if the encoder measures the position."""
        for name, value in self.named(
            {key: getattr(self, key) for key in ("speed_noise_rad_s", "start_rad")}
        ).items():
            if self.encoder == "position" and value is not None:
                raise ValueError(f"{name}: {value:g} needs encoder: speed; must be left out")
        return self

    @property
    def position_sigma_rad(self) -> float:
        """1 sigma of one position sample, with the error of its time at half the speed limit."""
        stamp_s = 0.0 if self.timing is None else self.timing.sigma_s or 0.0
        return hypot(self.position_noise_rad, 0.5 * self.speed_limit_rad_s * stamp_s)

    @property
    def speed_only(self) -> bool:
        """Whether the encoder measures speed and no position."""
        return self.encoder == "speed"

    @model_validator(mode="wrap")
    @classmethod
    def _in_metres(cls, data: object, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Translate the keys of a prismatic joint, which end in units of m and N (see `linear`)."""
        if not (isinstance(data, dict) and data.get("kind") == "prismatic"):
            return handler(data)
        names = {linear(name): name for name in cls.model_fields}
        wrong = next((key for key in data if key in cls.model_fields and key not in names), None)
        if wrong is not None:
            raise ValueError(f"{wrong}: of a prismatic joint it is {linear(wrong)}")
        try:
            return handler({names.get(key, key): value for key, value in data.items()})
        except ValidationError as error:
            faults = [_in_its_words(fault) for fault in error.errors()]
            raise ValidationError.from_exception_data(error.title, faults) from error

    def named(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return values with the keys that they have in the YAML section of this joint."""
        return {key if self.kind == "revolute" else linear(key): values[key] for key in values}

    @model_serializer(mode="wrap")
    def _as_read(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the section with the keys that it has in YAML."""
        values: dict[str, Any] = handler(self)
        return self.named(values)


def minute_walk(joint: JointConfig, rate_hz: float) -> float:
    """Return 1 sigma of the drift in a minute [rad or m] of an angle integrated from speed."""
    return (joint.speed_noise_rad_s or 0.0) * sqrt(60.0 / rate_hz)


def linear(key: str) -> str:
    """Return a revolute joint's key as a prismatic joint has it: m for rad, N for N m."""
    for unit, other in (
        ("_nms_rad", "_ns_m"),
        ("_kg_m2", "_kg"),
        ("_rad_s", "_m_s"),
        ("_rad", "_m"),
        ("_nm", "_n"),
    ):
        if key.endswith(unit):
            key = key.removesuffix(unit) + other
            break
    return key.replace("torque", "force")


def _in_its_words(fault: ErrorDetails) -> InitErrorDetails:
    """Return a fault with the key's name for a prismatic joint."""
    place = tuple(linear(part) if isinstance(part, str) else part for part in fault["loc"])
    kind, message = fault["type"], fault["msg"].replace("{", "{{").replace("}", "}}")
    return InitErrorDetails(
        type=PydanticCustomError(kind, message, fault.get("ctx")), loc=place, input=fault["input"]
    )


def _one_orientation(schema: dict[str, Any]) -> None:
    """Add to a JSON schema that exactly one of quaternion and angles is required."""
    schema["required"] = ["p_BS_m"]
    schema["oneOf"] = [{"required": [key]} for key in ("q_BS_xyzw", "rpy_BS_rad")]


class Mounting(Section):
    """Pose of a sensor on the base: origin in B, and rotation from S components to B."""

    model_config = ConfigDict(json_schema_extra=_one_orientation)

    p_BS_m: Position
    q_BS_xyzw: Quaternion
    rpy_BS_rad: tuple[Finite, Finite, Finite] | None = None  # converted to q_BS_xyzw

    @model_validator(mode="before")
    @classmethod
    def _from_angles(cls, data: object) -> object:
        """Replace roll, pitch and yaw (fixed axes, as in a URDF) by the quaternion."""
        if not isinstance(data, dict) or data.get("rpy_BS_rad") is None:
            return data
        angles = data["rpy_BS_rad"]
        if "q_BS_xyzw" in data:
            raise ValueError("rpy_BS_rad: given beside q_BS_xyzw; must be one of the two")
        if not (
            isinstance(angles, list | tuple)
            and len(angles) == 3
            and all(isinstance(x, int | float) and isfinite(x) for x in angles)
        ):
            raise ValueError(f"rpy_BS_rad: {brief(angles)} must be three finite numbers")
        if any(abs(angle) > MAX_ANGLE_RAD for angle in angles):
            raise ValueError(
                f"rpy_BS_rad: {brief(angles)} must be radians, each at most {MAX_ANGLE_RAD:g}; "
                "are these degrees?"
            )
        rest = {key: value for key, value in data.items() if key != "rpy_BS_rad"}
        return rest | {"q_BS_xyzw": _quaternion(angles)}

    @field_validator("q_BS_xyzw")
    @classmethod
    def _unit(cls, q: Quaternion) -> Quaternion:
        norm = sum(x * x for x in q) ** 0.5
        if abs(norm - 1.0) > 1e-6:
            raise ValueError(f"q_BS_xyzw {list(q)} has norm {norm:.9g}; must be 1 within 1e-6")
        return q


def _quaternion(angles: Sequence[float]) -> list[float]:
    """Return the quaternion (scalar last) of Rz(yaw) Ry(pitch) Rx(roll)."""
    from scipy.spatial.transform import Rotation  # takes 0.2 s, which few configurations need

    quaternion: list[float] = Rotation.from_euler("xyz", angles).as_quat().tolist()
    return quaternion


class ImuConfig(Section):
    """The inertial unit. For white noise of random walk N, 1 sigma of a sample is N sqrt(rate)."""

    driver: Driver = "stim300"  # none: there is no unit; samples: see SAMPLES
    options: dict[str, Any] = Field(default_factory=dict)  # of the codec, see `fsw devices`
    port: str | None = None  # a replay does not need it
    bus: str | None = None  # of driver samples: the feed
    baud_rate: int = Field(default=921600, gt=0)
    rate_hz: Rate
    crlf: bool = False  # datagrams are followed by CR LF
    acc_range_g: Literal[5, 10, 30, 80] = 10
    mounting: Mounting
    gyro_group_delay_s: Delay
    acc_group_delay_s: Delay
    angle_random_walk_rad_sqrt_s: RandomWalk
    velocity_random_walk_m_s_sqrt_s: RandomWalk
    gyro_bias_sigma_rad_s: RateSigma  # prior of the unknown bias; 0: none estimated
    acc_bias_sigma_m_s2: AccelerationSigma
    gyro_bias_S_rad_s: Vector3 = (0.0, 0.0, 0.0)  # subtracted from every sample, in S
    acc_bias_S_m_s2: Vector3 = (0.0, 0.0, 0.0)
    gyro_matrix: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    gyro_scale_sigma_ratio: ScaleSigma = 0.0  # 1 sigma of the scale of each axis; 0: exact
    gyro_axes_sigma_rad: AngleSigma = 0.0  # 1 sigma of the lean of axes to each other; 0: exact
    mounting_position_sigma_m: Length = 0.01  # 1 sigma of mounting.p_BS_m; 0: exact
    mounting_angle_sigma_rad: AngleSigma = 5e-3  # 1 sigma of the mounting about an axis; 0: exact
    max_rate_rad_s: Positive = 6.98  # larger readings are rejected as out of range (400 deg/s)
    clock_tolerance_ppm: Positive = 200.0

    @field_validator("gyro_matrix")
    @classmethod
    def _nearly_one(cls, matrix: Matrix3) -> Matrix3:
        for i, row in enumerate(matrix):
            for k, entry in enumerate(row):
                if abs(entry - (i == k)) > MOST_GYRO_ERROR:
                    raise ValueError(
                        f"gyro_matrix[{i}][{k}]: {entry:g}; must be {int(i == k)} within "
                        f"{MOST_GYRO_ERROR:g}"
                    )
        return matrix

    @property
    def present(self) -> bool:
        """Whether the robot has an inertial unit."""
        return self.driver != NONE

    @property
    def is_serial(self) -> bool:
        """Whether the unit sends bytes on a line, so that a codec reads them."""
        return self.driver not in (NONE, SAMPLES)


def no_imu() -> ImuConfig:
    """Return the section for a robot without inertial unit, without states of the unit."""
    return ImuConfig(
        driver=NONE,
        rate_hz=500.0,
        mounting=Mounting(p_BS_m=(0.0, 0.0, 0.0), q_BS_xyzw=(0.0, 0.0, 0.0, 1.0)),
        gyro_group_delay_s=0.0,
        acc_group_delay_s=0.0,
        angle_random_walk_rad_sqrt_s=1.0,
        velocity_random_walk_m_s_sqrt_s=1.0,
        gyro_bias_sigma_rad_s=0.0,
        acc_bias_sigma_m_s2=0.0,
        mounting_position_sigma_m=0.0,
        mounting_angle_sigma_rad=0.0,
    )


class StarTrackerConfig(Section):
    """The star tracker. `rotation` states the sense of its quaternion; confirm it by a test."""

    driver: Driver = "sagitta"
    options: dict[str, Any] = Field(default_factory=dict)  # of the codec, see `fsw devices`
    port: str | None = None
    bus: str | None = None  # of driver samples: the feed
    baud_rate: int = Field(default=115200, gt=0)
    rate_hz: Rate
    mounting: Mounting
    time: Literal["unit", "arrival"] = "arrival"  # stamp of the unit, or arrival less latency
    latency_s: Delay  # from mid-exposure to the unit's time stamp, or to the last byte
    rotation: Literal["inertial_to_tracker", "tracker_to_inertial"] = "inertial_to_tracker"
    noise_across_rad: AngleNoise
    noise_about_rad: AngleNoise
    subscribe: bool = True  # ask the unit for asynchronous solutions at start
