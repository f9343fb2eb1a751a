"""The limits that a trajectory must keep: the limits file, and the resulting limits per joint."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationError

from fsw.config import Finite, NonNegative, Positive, PositiveVector3, Section, Vector3
from fsw.config.text import LIMITS, TextError, explain, must_be, read_yaml
from fsw.errors import ConfigError
from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray
from planner.firings import Firing

Bound = tuple[Finite | None, Finite | None]


class TargetBox(Section):
    """Geometry of the grasped target for the collision check: a box in the tool frame."""

    center_m: Vector3
    size_m: PositiveVector3


class SlidingLimits(Section):
    """Bounds on every prismatic joint; `MotionLimits` has those of the revolute joints."""

    range_margin_m: NonNegative
    speed_m_s: Positive
    acceleration_m_s2: Positive
    jerk_m_s3: Positive | None = None
    force_n: Positive

    def row(self) -> tuple[float, ...]:
        """Return margin, speed, acceleration, jerk (unbounded: inf) and effort."""
        jerk = self.jerk_m_s3 or np.inf
        return self.range_margin_m, self.speed_m_s, self.acceleration_m_s2, jerk, self.force_n


class MotionLimits(Section):
    """Bounds on a whole motion; vectors of the base are bounded by their norm.

    Tool quantities are relative to the arm's base: the frame of the first joint at zero. The
    ranges, speeds and efforts of the URDF must be kept as well.
    """

    joint_range_margin_rad: NonNegative
    joint_speed_rad_s: Positive
    joint_acceleration_rad_s2: Positive
    joint_jerk_rad_s3: Positive | None = None
    torque_nm: Positive
    sliding: SlidingLimits | None = None  # required if a joint is prismatic
    base_attitude_rad: Positive
    base_rate_rad_s: Positive
    base_acceleration_rad_s2: Positive
    tool_box_m: tuple[Bound, Bound, Bound]  # x, y, z: lower and upper, null where unbounded
    tool_distance_m: NonNegative  # least distance of the tool from the arm's base
    clearance_m: NonNegative | None = None  # least distance of collision pairs; null: unchecked
    target_box: TargetBox | None = None
    mode_amplitude: Mapping[str, Positive] = Field(default_factory=dict)  # by name [rad or m]
    firings: tuple[Firing, ...] = ()  # during the motion
    # fixed first and last pose; prismatic joints in m
    start_rad: Annotated[tuple[Finite, ...], Field(min_length=1)] | None = None
    end_rad: Annotated[tuple[Finite, ...], Field(min_length=1)] | None = None

    def row(self) -> tuple[float, ...]:
        """Return margin, speed, acceleration, jerk (unbounded: inf) and effort."""
        speed, acceleration = self.joint_speed_rad_s, self.joint_acceleration_rad_s2
        jerk = self.joint_jerk_rad_s3 or np.inf
        return self.joint_range_margin_rad, speed, acceleration, jerk, self.torque_nm


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
    """Limits per joint (n,): the limits file combined with the URDF's ranges, speeds and efforts.

    The limits of a prismatic joint are in m, s and N, although the names end in rad and nm.
    """

    def __init__(self, limits: MotionLimits, model: RobotModel) -> None:
        own, slides = model.model, np.array([kind == "prismatic" for kind in model.kinds()])
        sliding = limits.sliding
        if sliding is None and slides.any():
            name = model.joint_names[int(slides.argmax())]
            raise ConfigError(f"sliding: missing; {name!r} is prismatic, its limits stand there")

        margin, speed, acceleration, jerk, effort = (
            np.where(slides, straight, turning)
            for turning, straight in zip(limits.row(), (sliding or limits).row(), strict=True)
        )
        self.units: tuple[str, ...] = tuple(np.where(slides, "m", "rad").tolist())
        self.lower_rad: FloatArray = np.array(own.lowerPositionLimit[7:]) + margin
        self.upper_rad: FloatArray = np.array(own.upperPositionLimit[7:]) - margin
        self.speed_rad_s: FloatArray = np.minimum(speed, own.velocityLimit[6:])
        self.acceleration_rad_s2: FloatArray = acceleration
        self.jerk_rad_s3: FloatArray = jerk
        self.torque_nm: FloatArray = np.minimum(effort, own.effortLimit[6:])
        for key in ("start_rad", "end_rad"):
            pose = getattr(limits, key)
            if pose is not None and len(pose) != model.n:
                raise ConfigError(f"{key}: has {len(pose)} joints; the robot has {model.n}")
        if np.any(self.lower_rad >= self.upper_rad):
            j = int((self.lower_rad >= self.upper_rad).argmax())
            key = "sliding.range_margin_m" if slides[j] else "joint_range_margin_rad"
            raise ConfigError(f"{key}: {margin[j]:g} leaves no range to {model.joint_names[j]!r}")
