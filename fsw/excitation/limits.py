"""The limits a trajectory must keep: their file, and the share of each that a motion uses."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationError

from fsw.config import Finite, NonNegative, Positive, PositiveVector3, Section, Vector3
from fsw.config.text import LIMITS, TextError, explain, must_be, read_yaml
from fsw.estimators.model.robot import RobotModel
from fsw.excitation.spline import Firing
from fsw.messages import FloatArray
from fsw.messages.errors import ConfigError

Bound = tuple[Finite | None, Finite | None]


class TargetBox(Section):
    """Geometry of the grasped target for the collision check: a box in the tool frame."""

    center_m: Vector3
    size_m: PositiveVector3


class MotionLimits(Section):
    """Bounds on a whole motion; vectors of the base are bounded by their norm.

    Tool quantities are relative to the arm's base: the frame of the first joint at zero. Ranges,
    speeds and efforts of the URDF bind too.
    """

    joint_range_margin_rad: NonNegative
    joint_speed_rad_s: Positive
    joint_acceleration_rad_s2: Positive
    joint_jerk_rad_s3: Positive | None = None
    torque_nm: Positive
    base_attitude_rad: Positive
    base_rate_rad_s: Positive
    base_acceleration_rad_s2: Positive
    tool_box_m: tuple[Bound, Bound, Bound]  # x, y, z: lower and upper, null where unbounded
    tool_distance_m: NonNegative  # the tool keeps out of this sphere about the arm's base
    clearance_m: NonNegative | None = None  # of collision geometry; null: unchecked
    target_box: TargetBox | None = None
    mode_amplitude: Mapping[str, Positive] = Field(default_factory=dict)  # by name [rad or m]
    firings: tuple[Firing, ...] = ()  # of thrusters, that are flown beside the motion
    start_rad: Annotated[tuple[Finite, ...], Field(min_length=1)] | None = None
    end_rad: Annotated[tuple[Finite, ...], Field(min_length=1)] | None = None


def load(path: Path) -> MotionLimits:
    """Read a limits file.

    Raises
    ------
    ConfigError with one line per fault: key, value, bound.
    """
    try:
        source = path.read_bytes()
        must_be(source, str(path), LIMITS)
        data = read_yaml(source)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except TextError as error:
        raise ConfigError(f"{path}: {error}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: must be a mapping; found {type(data).__name__}")
    try:
        return MotionLimits.model_validate(data)
    except ValidationError as error:
        lines = [f"{path}: {line}" for line in explain(MotionLimits, error)]
        raise ConfigError("\n".join(lines)) from error


class JointLimits:
    """A limits file joined with the robot's own ranges, speeds and efforts, per joint (n,)."""

    def __init__(self, limits: MotionLimits, model: RobotModel) -> None:
        own, margin = model.model, limits.joint_range_margin_rad
        self.lower_rad: FloatArray = np.array(own.lowerPositionLimit[7:]) + margin
        self.upper_rad: FloatArray = np.array(own.upperPositionLimit[7:]) - margin
        self.speed_rad_s: FloatArray = np.minimum(limits.joint_speed_rad_s, own.velocityLimit[6:])
        self.torque_nm: FloatArray = np.minimum(limits.torque_nm, own.effortLimit[6:])
        for key in ("start_rad", "end_rad"):
            pose = getattr(limits, key)
            if pose is not None and len(pose) != model.n:
                raise ConfigError(f"{key}: has {len(pose)} joints; the robot has {model.n}")
        if np.any(self.lower_rad >= self.upper_rad):
            raise ConfigError(
                f"joint_range_margin_rad: {margin} leaves no range to some joint of the robot"
            )
