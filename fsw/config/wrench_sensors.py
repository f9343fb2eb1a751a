"""Section of force-torque sensors in an arm, for example at its wrist."""

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from fsw.config.base import (
    Delay,
    ForceNoise,
    ForceSigma,
    Position,
    Positive,
    Rate,
    ScaleSigma,
    Section,
    TorqueNoise,
    TorqueSigma,
    Turn,
)

METHODS = ("fused", "rda", "cm")  # cm uses gyro and no torque; mrnea's rows are base and joints


class WrenchSensorConfig(Section):
    """A sensor of force and moment between two bodies of an arm.

    It measures the wrench by which the arm holds the link `frame` and everything beyond, a grasped
    target included, about the origin of S in axes S. Its samples come from `fsw import` only.
    """

    columns: ClassVar = {"force_n": "object", "torque_nm": "object"}  # recorded: x y z by name
    width: ClassVar = 6  # values of a sample in axes S: force [N], moment about its origin [N m]
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")]
    """its name in messages, and in the recording; not that of a joint"""
    rate_hz: Rate
    """rate of its samples"""
    frame: str
    """the first link that the sensor carries, or the joint that moves this link; not the root link
    """
    p_FS_m: Position = (0.0, 0.0, 0.0)
    """origin of the sensor's axes in the frame of that link; moments are about it"""
    rpy_FS_rad: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)
    """roll, pitch, yaw of the sensor's axes in that frame, about fixed axes as in a URDF"""
    sign: Literal[-1, 1] = 1
    """-1 when the sensor reports the wrench that the carried bodies exert on it: a hanging weight
    then pulls it down"""
    force_limit_n: Positive
    """larger readings are physically impossible and rejected"""
    torque_limit_nm: Positive
    """likewise, of a moment"""
    force_noise_n: ForceNoise
    """1 sigma of one sample of a force, white, quantisation included; below its limit"""
    torque_noise_nm: TorqueNoise
    """likewise, of a moment"""
    force_offset_sigma_n: ForceSigma
    """1 sigma of the unknown offset of each force; 0: none is estimated"""
    torque_offset_sigma_nm: TorqueSigma
    """likewise, of each moment"""
    scale_sigma_ratio: ScaleSigma = 0.01
    """1 sigma of the scale error of each axis; half of its variance is taken as common to all axes.
    0: none is estimated"""
    delay_s: Delay = 0.0
    """by which the readings are late; `estimator.lag_s` must cover it"""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for noise, limit in (
            ("force_noise_n", "force_limit_n"),
            ("torque_noise_nm", "torque_limit_nm"),
        ):
            if getattr(self, noise) >= getattr(self, limit):
                raise ValueError(
                    f"{noise}: {getattr(self, noise):g} must be below {limit} "
                    f"{getattr(self, limit):g}"
                )
        return self

    @property
    def noise(self) -> tuple[float, ...]:
        """Return 1 sigma of a sample of every axis: three forces [N], three moments [N m]."""
        return (self.force_noise_n,) * 3 + (self.torque_noise_nm,) * 3

    @property
    def limits(self) -> tuple[float, ...]:
        """Return the limit of every axis."""
        return (self.force_limit_n,) * 3 + (self.torque_limit_nm,) * 3


def wrench_sensors_go_with(sensors: Sequence[WrenchSensorConfig], method: str) -> None:
    """Raise ValueError if the method has no rows for wrench sensors."""
    if sensors and method not in METHODS:
        raise ValueError(
            f"estimator.method: {method!r} has no rows for wrench_sensors; must be "
            f"{', '.join(METHODS[:-1])} or {METHODS[-1]}"
        )
