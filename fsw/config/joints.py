"""Configuration of joints: nodes, units, calibration, noise and friction."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from math import sqrt
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import (
    ConfigDict,
    ModelWrapValidatorHandler,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from fsw.config.base import (
    AngleNoise,
    AngleSigma,
    CorrelationTime,
    DelayError,
    DelaySigma,
    Finite,
    Gain,
    NodeId,
    Periods,
    Positive,
    RotorSigma,
    ScaleSigma,
    Section,
    SlowRate,
    SpeedNoise,
    TorqueNoise,
    TorqueSigma,
    Turn,
)
from fsw.config.feed import SAMPLES
from fsw.config.signals import Role, SignalConfig, TimingConfig, has_its_keys, is_described
from fsw.errors import brief

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
    "torque_delay_s": 0.0,
    "torque_delay_sigma_s": 0.0,
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
    """the joint's name in the URDF; every revolute or prismatic joint must be listed once, in any
    order"""
    driver: Literal["canopen", "described", "samples"] = "canopen"
    """`canopen`: the tailored node of [icd.md](icd.md); `described`: any device, by `signals` and
    `timing` ([how](howto/connect.md)); `samples`: values of a [feed](howto/feed.md), in the order
    of this list"""
    bus: str
    """name of the bus the node is on, or of the feed"""
    node_id: NodeId | None = None
    """CANopen node; required by `canopen`, and by `described` with a `description` of its own; such
    a node is started by NMT; left out with `samples`"""
    description: Path | None = None
    """EDS or DCF file of this node; its messages are `TPDO1`, `TPDO2` ..., its signals `0x6064`,
    `0x2012:03` ...; null: the bus's description"""
    pdo: Literal["trusted", "checked", "written"] = "trusted"
    """the PDOs of such a node that its signals name: `trusted` to be as in its file; `checked`
    against it by SDO before the node is started; `written` by SDO, then checked. A node that
    differs is not started (`NODE_DIFFERS`)"""
    signals: dict[Role, SignalConfig] | None = None  # for driver: described
    timing: TimingConfig | None = None  # likewise
    format: Literal["classic", "fd"] = "classic"
    """TPDO1 layout: 8 bytes classic, or the 20-byte CAN FD tailoring"""
    kind: Literal["revolute", "prismatic"] = "revolute"
    """as in the URDF; `prismatic`: the node counts metres where others count revolutions
    ([icd.md](icd.md), section 1), and the keys are named for m and N"""
    sign: Literal[-1, 1] = 1
    """-1 when the node counts against the URDF's axis; for position and torque alike"""
    zero_offset_rad: Turn = 0.0
    """position = sign x reading - this"""
    torque: Literal["link_side", "motor_current", "none"] = "link_side"
    """`motor_current`: the torque is computed from the motor's current; friction, rotor inertia and
    gain then have wide priors unless stated ([how](howto/motor_current.md)). `none`: the node
    measures angles alone (a second arm without sensors, a driven antenna); the `torque_...` and
    `friction_...` keys are then left out. Methods `fused`, `rda` and `cm` do without that torque,
    `mrnea` does not"""
    torque_gain: Gain = 1.0
    """not 0; torque = sign x gain x reading - offset; negative: the torque alone counts the other
    way"""
    torque_offset_nm: Finite = 0.0
    """known torque offset, taken off as `torque_gain` says"""
    torque_limit_nm: Positive
    """larger readings are physically impossible and rejected"""
    speed_limit_rad_s: Positive
    """faster position jumps between samples are rejected"""
    torque_noise_nm: TorqueNoise
    """1 sigma of one torque sample, white, quantisation included"""
    torque_offset_sigma_nm: TorqueSigma
    """1 sigma of the unknown torque offset; 0: none is estimated"""
    torque_scale_sigma_ratio: ScaleSigma = 0.02
    """1 sigma of the unknown torque scale error; half of its variance is taken as common to all
    joints (one calibration). Calibrated against weights: 0.005; 0: none is estimated"""
    friction_coulomb_sigma_nm: TorqueSigma = 0.0
    """1 sigma of the Coulomb friction that the torque sensor sees beside the dynamics: what acts
    between the sensor and the link (bearing, seal, cables), or what is left of it after a
    compensation in the joint. Set it where a test on the ground showed such friction, or where a
    motion with reversals ends in `MODEL_MISMATCH`: link-side sensors of light arms showed 0.2 to
    0.5 N m. It costs information: offset and friction look alike where a joint never reverses.
    Outliers of torque are judged more mildly then. 0: none is estimated"""
    friction_viscous_sigma_nms_rad: TorqueSigma = 0.0
    """1 sigma of the viscous part [N m s/rad]; set it with `friction_coulomb_sigma_nm` where joints
    move faster than some 0.1 rad/s. 0: none is estimated"""
    friction_load_sigma_ratio: ScaleSigma = 0.0
    """with `torque: motor_current` 0.1: 1 sigma of the friction of a loaded gear over the torque
    that it transmits, for a torque from [motor current](howto/motor_current.md) of an arm with
    `base.motion: clamped`; no state elsewhere. 0: none is estimated"""
    friction_speed_rad_s: SlowRate = 0.01
    """Coulomb friction is c tanh(rate / this). Smaller where it reverses sharply, larger where it
    builds up slowly, as cables do"""
    rotor_inertia_sigma_kg_m2: RotorSigma = 0.0
    """1 sigma of the inertia of rotor and gear about the joint's axis, times the gear ratio
    squared, for a torque from [motor current](howto/motor_current.md). It adds that inertia times
    the joint's acceleration to the reading. 0: none is estimated"""
    ripple_periods: tuple[Periods, ...] = ()
    """numbers of periods of the gear's ripple in a turn of the joint; revolute joints only"""
    ripple_sigma_nm: TorqueSigma = 0.0
    """1 sigma of the amplitudes of sine and cosine of each ripple; 0: no ripple"""
    torque_model_sigma_nm: TorqueSigma = 0.0
    """1 sigma of what the model leaves out of this joint's torque: friction that depends on load,
    angle and temperature, cables, a controller's vibration. Set it on real hardware, from the
    residual of a motion without payload (0.05 to 0.2 N m were seen on arms of 15 kg); 0: nothing is
    left out"""
    torque_model_correlation_s: CorrelationTime = 0.1
    """time in which that fades by e. Up to `estimator.window_s`; what is slower is an offset,
    friction or an error of the links, which have keys of their own"""
    torque_delay_s: DelayError = 0.0
    """by which the torque of a sample is later than its angle, as a filter or a second source makes
    it; written by `fsw calibrate motion`"""
    torque_delay_sigma_s: DelaySigma = 0.0
    """1 sigma of it, a state; at most a tenth of `estimator.window_s`. Not known: 0.01; 0: exact"""
    encoder: Literal["position", "speed"] = "position"
    """`speed`: the node measures speed and no angle (a tachometer, an encoder without index). The
    angle is then integrated from `start_rad`; `position_noise_rad` and `zero_offset_rad` are left
    out. Use it only where there is no angle: the arm must stand within `zero_sigma_rad` of
    `start_rad` when `fsw run` or a recording begins, and what the noise adds up to costs sigma
    ([methods.md](methods.md)). Not with method `mrnea`, nor where something but the arm changes the
    momentum (`fsw check` names the key); `fsw excite` and `fsw import` refuse it"""
    position_noise_rad: AngleNoise
    """1 sigma of one position sample, quantisation included"""
    speed_noise_rad_s: SpeedNoise | None = None
    """of `encoder: speed`, and required there: 1 sigma of one speed sample, white. The angle walks
    by this times the root of time over rate: 0.01 rad/s at 500 Hz make 0.2 deg in a minute; beyond
    0.3 deg `fsw check` warns"""
    start_rad: Turn | None = None
    """of `encoder: speed`: the angle, in the URDF's zero and sign, before the first sample; null: 0
    """
    zero_sigma_rad: AngleSigma = 2e-3
    """1 sigma of `zero_offset_rad`, or of `start_rad`. Calibrated on a bench: 0.0003; 0: it is
    exact"""
    angle_scale_sigma_ratio: ScaleSigma = 0.0
    """1 sigma of the scale of the angle's reading: a true angle, before `zero_offset_rad`, over the
    reading, minus 1. 0: it is exact; a change within the run is watched. Not with `encoder: speed`
    nor `modes`"""
    link_sigma_ratio: ScaleSigma | None = None
    """of the link this joint moves, instead of `robot.links_sigma_ratio`, where one link is known
    better or worse than the others"""

    @model_validator(mode="after")
    def _driver_keys(self) -> Self:
        """Refuse a joint that lacks a key of its driver, or has a key of another one."""
        needs: dict[str, bool | None] = {"canopen": True, SAMPLES: False}
        has_its_keys(self, {"node_id": needs.get(self.driver)})
        roles: list[Role] = ["speed" if self.speed_only else "position"]
        roles += ["torque"] if self.torque != "none" else []
        is_described(self, roles, f"encoder {self.encoder}, torque {self.torque}")
        if self.pdo != "trusted" and self.description is None:
            raise ValueError(f"pdo: {self.pdo!r} without description, an EDS or DCF of the node")
        return self

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
    def stamp_sigma_s(self) -> float:
        """1 sigma of the error of one sample's time."""
        return 0.0 if self.timing is None else self.timing.sigma_s or 0.0

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
        """Return values, keyed by field name, under this joint's YAML keys; see `linear`."""
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
    """Return the prismatic joint's name of a revolute joint's key: m for rad, N for N m."""
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
