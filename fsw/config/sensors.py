"""Configuration of the inertial unit and the star tracker."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, tau
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

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
    DelaySigma,
    Finite,
    Length,
    Matrix3,
    NodeId,
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
from fsw.config.signals import (
    DESCRIBED,
    FORCES,
    QUATERNION,
    RATES,
    Role,
    SignalConfig,
    TimingConfig,
    has_its_keys,
    is_described,
)
from fsw.errors import brief

MAX_ANGLE_RAD = tau  # of a mounting; larger angles are probably in degrees
MOST_GYRO_ERROR = 0.2  # of an entry of gyro_matrix; a larger error is a wrong unit or mounting
Driver = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+(:[A-Za-z0-9_.]+)?$", max_length=200)]
NONE = "none"  # stands for a device that the robot does not have


def _one_orientation(schema: dict[str, Any]) -> None:
    """Add to a JSON schema that exactly one of quaternion and angles is required."""
    schema["required"] = ["p_BS_m"]
    schema["oneOf"] = [{"required": [key]} for key in ("q_BS_xyzw", "rpy_BS_rad")]


class Mounting(Section):
    """Pose of a sensor on the base: origin in B, and rotation from S components to B."""

    model_config = ConfigDict(json_schema_extra=_one_orientation)

    p_BS_m: Position
    """place of the sensor in B (of an accelerometer: the lever arm); attitude does not depend on it
    """
    q_BS_xyzw: Quaternion
    """unit quaternion, scalar last, taking sensor components to B; not with `rpy_BS_rad`"""
    rpy_BS_rad: tuple[Finite, Finite, Finite] | None = None
    """roll, pitch, yaw in place of the quaternion, each at most 2 pi either way: about the
    fixed axes x, y, z of B in this order, as `rpy` of a URDF"""

    @model_validator(mode="before")
    @classmethod
    def _from_angles(cls, data: object) -> object:
        """Replace roll, pitch and yaw (fixed axes, as in a URDF) by the quaternion."""
        if not isinstance(data, dict) or data.get("rpy_BS_rad") is None:
            return data
        angles = data["rpy_BS_rad"]
        if "q_BS_xyzw" in data:
            raise ValueError("rpy_BS_rad: given together with q_BS_xyzw; must be one of the two")
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

    name: ClassVar = "imu"
    kind: ClassVar = "revolute"  # of its units, as of a joint
    driver: Driver = "stim300"
    """wire format: name of an installed codec, see `fsw devices`, or `package.module:Codec`;
    `described`: any unit on a CAN bus, by `signals` and `timing` ([how](howto/connect.md));
    `samples`: its values come from [fsw import](import.md), or live by the feed `bus`, at any rate;
    `none` stands where the section is left out, which only `base.motion: clamped` allows"""
    options: dict[str, Any] = Field(default={})
    """the options of the codec, see `fsw devices`; `kvh` needs `rotation` and `acceleration`, which
    say what the unit was set to send"""
    port: str | None = None
    """required by `fsw run` only: path of the serial device or pseudo-terminal, or a pyserial URL
    """
    bus: str | None = None
    """of `samples`: the [feed](howto/feed.md) that carries the unit; of `described`: its bus"""
    node_id: NodeId | None = None
    """of `described`: CANopen node, where `description` is"""
    description: Path | None = None
    """EDS or DCF file of this node"""
    signals: dict[Role, SignalConfig] | None = None  # for driver: described
    timing: TimingConfig | None = None  # likewise
    baud_rate: int = Field(default=921600, gt=0)
    """bit/s; must carry the datagrams"""
    rate_hz: Rate
    """datagram rate: one that the codec's device offers; stim300: 125, 250, 500, 1000 or 2000"""
    crlf: bool = False
    """datagrams of a stim300 end in CR LF"""
    acc_range_g: Literal[5, 10, 30, 80] = 10
    """accelerometer range: larger readings are rejected; of a stim300 it sets the scale of the wire
    """
    mounting: Mounting
    gyro_group_delay_s: Delay
    """delay of the unit's filter, not contained in the latency field; at most 0.1"""
    acc_group_delay_s: Delay
    """likewise of the accelerometer, usually another; at most 0.1"""
    delay_sigma_s: DelaySigma = 0.0
    """1 sigma of each of the two against the joints, two states; at most a tenth of
    `estimator.window_s`. 0: exact"""
    angle_random_walk_rad_sqrt_s: RandomWalk
    """white noise density of the gyro, rad/sqrt(s); 0.15 deg/sqrt(h) is 4.36e-5"""
    velocity_random_walk_m_s_sqrt_s: RandomWalk
    """white noise density of the accelerometer, (m/s)/sqrt(s); 0.06 m/s/sqrt(h) is 1e-3"""
    gyro_bias_sigma_rad_s: RateSigma
    """1 sigma of the unknown gyro bias; 0: none is estimated"""
    acc_bias_sigma_m_s2: AccelerationSigma
    """1 sigma of the unknown accelerometer bias; 0: none is estimated"""
    gyro_bias_S_rad_s: Vector3 = (0.0, 0.0, 0.0)
    """known gyro bias in the unit's own axes, taken off every sample; written by `fsw calibrate`"""
    acc_bias_S_m_s2: Vector3 = (0.0, 0.0, 0.0)
    """likewise of the accelerometer"""
    gyro_matrix: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """three rows: what a reading, its bias taken off, is multiplied by to be the rate along the
    unit's axes: scales on the diagonal, each within 0.2 of the identity; of a data sheet, or
    written by `fsw calibrate motion`"""
    gyro_scale_sigma_ratio: ScaleSigma = 0.0
    """1 sigma of the scale of each of the gyro's axes, a state; 0: exact, no state. Where the base
    turns fast (a captured or thrown body, above some 0.5 rad/s): 0.005 of a MEMS unit, 3e-4 of one
    calibrated by its maker"""
    gyro_axes_sigma_rad: AngleSigma = 0.0
    """1 sigma of the angle by which each of two axes of the gyro leans to the other, so that they
    miss a right angle by twice as much, three states; 0: exact. MEMS: 0.01, calibrated by its
    maker: 5e-4. A turn of all axes is `mounting_angle_sigma_rad`"""
    mounting_position_sigma_m: Length = 0.01
    """1 sigma of `mounting.p_BS_m`, each axis. Measured on the built robot: 0.001; 0: it is exact
    """
    mounting_angle_sigma_rad: AngleSigma = 5e-3
    """1 sigma of `mounting.q_BS_xyzw` about each axis. Aligned optically: 0.0002; 0: it is exact"""
    max_rate_rad_s: Positive = 6.98
    """the unit's range (stim300: below 8.936, 512 deg/s, the most that its wire carries): larger
    readings are rejected, counted and reported (`IMU_RANGE`)"""
    clock_tolerance_ppm: Positive = 200.0
    """how far the unit's clock may be off"""

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
        return self.driver not in (NONE, SAMPLES, DESCRIBED)

    @model_validator(mode="after")
    def _keys_of_its_driver(self) -> Self:
        _checked(self, (*RATES, *FORCES))
        return self


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

    name: ClassVar = "star_tracker"
    kind: ClassVar = "revolute"
    driver: Driver = "sagitta"
    """wire format: name of an installed codec, see `fsw devices`, or `package.module:Codec`;
    `described`: on a CAN bus; `samples`: its values come from [fsw import](import.md), or live by
    the feed `bus`"""
    options: dict[str, Any] = Field(default={})
    """the options of the codec, see `fsw devices`"""
    port: str | None = None
    """required by `fsw run` only: path of the serial device or pseudo-terminal, or a pyserial URL
    """
    bus: str | None = None
    """of `samples`: the [feed](howto/feed.md) that carries the unit; of `described`: its bus"""
    node_id: NodeId | None = None
    """of `described`: CANopen node, where `description` is"""
    description: Path | None = None
    """EDS or DCF file of this node"""
    signals: dict[Role, SignalConfig] | None = None  # for driver: described
    timing: TimingConfig | None = None  # likewise
    baud_rate: int = Field(default=115200, gt=0)
    """bit/s; must carry the solutions"""
    rate_hz: Rate
    """solution rate"""
    mounting: Mounting
    time: Literal["unit", "arrival"] = "arrival"
    """`unit`: from the solution's own time stamp; `arrival`: from the arrival of its last byte"""
    latency_s: Delay
    """from mid-exposure to the unit's time stamp, or to the last byte"""
    rotation: Literal["inertial_to_tracker", "tracker_to_inertial"] = "inertial_to_tracker"
    """which way the unit's quaternion turns"""
    noise_across_rad: AngleNoise
    """1 sigma across the boresight"""
    noise_about_rad: AngleNoise
    """1 sigma about the boresight"""
    subscribe: bool = True
    """ask the unit for asynchronous solutions at the start"""

    @property
    def is_serial(self) -> bool:
        """Whether the unit sends bytes on a line, so that a codec reads them."""
        return self.driver not in (SAMPLES, DESCRIBED)

    @model_validator(mode="after")
    def _keys_of_its_driver(self) -> Self:
        _checked(self, QUATERNION)
        return self


def _checked(own: ImuConfig | StarTrackerConfig, roles: Sequence[Role]) -> None:
    """Raise ValueError for a key that the driver of a sensor needs or refuses."""
    found = is_described(own, roles, "a sensor")
    has_its_keys(own, {"node_id": own.description is not None, "port": False if found else None})
