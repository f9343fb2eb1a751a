"""Section of reaction wheels: rotors that exchange momentum with the base."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from fsw.config.base import (
    SLOWEST_HZ,
    SMALLEST,
    UNIT_TOLERANCE,
    Delay,
    DelaySigma,
    NodeId,
    Rate,
    ScaleSigma,
    Section,
    TorqueNoise,
    TorqueSigma,
    Vector3,
)
from fsw.config.signals import Role, SignalConfig, TimingConfig, has_its_keys, is_described

RotorInertia = Annotated[float, Field(ge=1e-9, le=1e4, allow_inf_nan=False)]
RotorSpeed = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
RotorSpeedNoise = Annotated[float, Field(ge=SMALLEST, le=1e3, allow_inf_nan=False)]
RotorTorque = Annotated[float, Field(gt=0, le=1e3, allow_inf_nan=False)]


class WheelConfig(Section):
    """One wheel: a rotor, symmetric about an axis that is fixed in the base."""

    columns: ClassVar = {"speed_rad_s": "object"}  # of its samples in a recording, by name
    kind: ClassVar = "revolute"  # of its units, as of a joint
    width: ClassVar = 2  # values of a sample: speed_rad_s, torque_nm (NaN: unusable)
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")]
    """its name in events and status"""
    driver: Literal["canopen", "described"] = "canopen"
    """`canopen`: the tailored node of [icd.md](icd.md); `described`: any device, by `signals` and
    `timing` as of a joint, in messages of its bus ([how](howto/connect.md))"""
    bus: str | None = None
    """name of the bus the node is on; null: its samples come by `fsw import` only"""
    node_id: NodeId | None = None
    """CANopen node; given where the bus is; with `described`, where `description` is"""
    description: Path | None = None
    """EDS or DCF file of this node"""
    signals: dict[Role, SignalConfig] | None = None  # for driver: described
    timing: TimingConfig | None = None  # likewise
    rate_hz: Rate
    """rate of its reports, at least 1 and at most the bus's SYNC rate"""
    axis_B: Vector3
    """unit vector of the axis in base axes; positive speed turns about it by the right-hand rule"""
    inertia_kg_m2: RotorInertia
    """inertia of the rotor about its axis"""
    inertia_sigma_ratio: ScaleSigma = 0.01
    """1 sigma of that inertia, which is a state; 0: it is exact"""
    speed_limit_rad_s: RotorSpeed
    """larger readings are physically impossible and rejected"""
    speed_noise_rad_s: RotorSpeedNoise
    """1 sigma of one speed sample, white, quantisation included; below `speed_limit_rad_s`"""
    delay_s: Delay = 0.0
    """by which its readings are late: a speed that is the mean of a revolution is so by half of it.
    Set it where the wheel is turned up within tenths of a second. `estimator.lag_s` must cover it
    """
    delay_sigma_s: DelaySigma = 0.0
    """1 sigma of it; the error is a state. 0: it is exact"""
    torque: Literal["none", "measured"] = "none"
    """`measured`: the node's motor torque is used beside its speed; worth it for slow reports"""
    torque_limit_nm: RotorTorque
    """of the motor; larger readings are not used"""
    torque_walk_nm_sqrt_s: RotorTorque | None = None
    """1 sigma by which the torque on the rotor changes in 1 s; it decides how far a speed is
    trusted between samples. null: `torque_limit_nm`"""
    torque_noise_nm: TorqueNoise | None = None
    """1 sigma of one torque sample, white; required for `torque: measured`"""
    torque_offset_sigma_nm: TorqueSigma = 0.02
    """1 sigma of bearing drag and offset, which a motor torque does not contain"""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        length = sum(x * x for x in self.axis_B) ** 0.5
        if not abs(length - 1.0) <= UNIT_TOLERANCE:
            raise ValueError(
                f"axis_B: {list(self.axis_B)} has length {length:.4g}; must have length 1"
            )
        roles: list[Role] = ["speed", "torque"] if self.torque == "measured" else ["speed"]
        if is_described(self, roles, f"torque {self.torque}"):
            has_its_keys(self, {"node_id": self.description is not None})
        elif (self.bus is None) != (self.node_id is None):
            given, missing = ("bus", "node_id") if self.node_id is None else ("node_id", "bus")
            value = getattr(self, given)
            raise ValueError(
                f"{given}: {value!r} without {missing}; a wheel on a bus has both, any other "
                "neither"
            )
        if self.rate_hz < SLOWEST_HZ:
            raise ValueError(f"rate_hz: {self.rate_hz:g} must be at least {SLOWEST_HZ:g}")
        if self.speed_noise_rad_s >= self.speed_limit_rad_s:
            raise ValueError(
                f"speed_noise_rad_s: {self.speed_noise_rad_s:g} must be below speed_limit_rad_s "
                f"{self.speed_limit_rad_s:g}"
            )
        if self.torque_noise_nm is not None and self.torque_noise_nm >= self.torque_limit_nm:
            raise ValueError(
                f"torque_noise_nm: {self.torque_noise_nm:g} must be below torque_limit_nm "
                f"{self.torque_limit_nm:g}"
            )
        if self.torque == "measured" and self.torque_noise_nm is None:
            raise ValueError("torque_noise_nm: missing; torque: measured needs it")
        return self

    @property
    def late_s(self) -> float:
        """Delay of its readings [s]."""
        return self.delay_s

    @property
    def walk_nm_sqrt_s(self) -> float:
        """Return 1 sigma of the change in 1 s of the torque on the rotor [N m / sqrt(s)]."""
        return self.torque_walk_nm_sqrt_s or self.torque_limit_nm
