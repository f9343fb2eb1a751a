"""Configuration of the inertial unit and the star tracker."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, tau
from typing import Annotated, Any, Literal

from pydantic import (
    ConfigDict,
    Field,
    field_validator,
    model_validator,
)

from fsw.config.base import (
    AccelerationSigma,
    AngleNoise,
    AngleSigma,
    Delay,
    Finite,
    Length,
    Matrix3,
    Position,
    Positive,
    Quaternion,
    RandomWalk,
    Rate,
    RateSigma,
    ScaleSigma,
    Section,
    Vector3,
)
from fsw.config.feed import SAMPLES
from fsw.errors import brief

MAX_ANGLE_RAD = tau  # of a mounting; larger angles are probably in degrees
MOST_GYRO_ERROR = 0.2  # of an entry of gyro_matrix; a larger error is a wrong unit or mounting
Driver = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.]+(:[A-Za-z0-9_.]+)?$", max_length=200)]
NONE = "none"  # stands for a device that the robot does not have


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
    options: dict[str, Any] = Field(default={})  # of the codec, see `fsw devices`
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
    options: dict[str, Any] = Field(default={})  # of the codec, see `fsw devices`
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
