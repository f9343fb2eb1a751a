"""The limits that every motion must keep (Rackl et al. 2013, eq. 18-20 and section 3.4)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.world.history import TruthHistory, rotation_matrices
from hil.world.robot import Robot

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds on the motion.

    Bounds on the base apply to the norm of a vector and to the angle of rotation since the start.
    This is stricter than bounds on components; the paper does not say which it means. Tool
    quantities are relative to the arm's base (frame of the first joint at zero).
    """

    attitude_rad: float = float(np.deg2rad(10.0))
    base_rate_rad_s: float = float(np.deg2rad(10.0))
    base_acceleration_rad_s2: float = float(np.deg2rad(10.0))
    joint_speed_rad_s: float = float(np.deg2rad(10.0))
    joint_acceleration_rad_s2: float = float(np.deg2rad(5.0))
    torque_nm: float = 40.0
    tool_box_m: float = 3.5
    tool_distance_m: float = 1.5


class LimitCheck(NamedTuple):
    """One limit: the worst value of the motion, its bound, and how much of it is used."""

    value: float
    bound: float
    ok: bool
    ratio: float  # 1 at the bound, larger beyond it


def check(
    robot: Robot, history: TruthHistory, limits: Limits | None = None
) -> dict[str, LimitCheck]:
    """Check a simulated motion against every limit.

    Returns
    -------
    one entry per limit; the ratio of `tool_height_m` is 0 (kept) or infinity (broken)
    """
    bound = limits or Limits()
    turn = rotation_matrices(history.quat_wxyz)
    relative = np.einsum("ji,kjl->kil", turn[0], turn)
    tool_m = arm_tool_positions(robot, history.q)
    return {
        "attitude_rad": _most(rotation_angles(relative), bound.attitude_rad),
        "base_rate_rad_s": _most(_norms(history.w_B), bound.base_rate_rad_s),
        "base_acceleration_rad_s2": _most(_norms(history.wd_B), bound.base_acceleration_rad_s2),
        "joint_speed_rad_s": _most(history.qd, bound.joint_speed_rad_s),
        "joint_acceleration_rad_s2": _most(history.qdd, bound.joint_acceleration_rad_s2),
        "torque_nm": _most(history.tau, bound.torque_nm),
        "joint_effort_ratio": _most(history.tau / robot.effort_nm, 1.0),
        "joint_range_ratio": _most(_range_ratio(robot, history.q), 1.0),
        "tool_box_m": _most(tool_m[:, :2], bound.tool_box_m),
        "tool_distance_m": _least(float(_norms(tool_m).min()), bound.tool_distance_m),
        "tool_height_m": _positive(float(tool_m[:, 2].min())),
    }


def worst(checks: dict[str, LimitCheck]) -> tuple[str, LimitCheck]:
    """Return name and check of the limit with the largest ratio."""
    return max(checks.items(), key=lambda item: item[1].ratio)


def arm_tool_positions(robot: Robot, q_rad: FloatArray) -> FloatArray:
    """Return the tool origin relative to the arm's base, in the arm base's axes, (k, 3) [m]."""
    p_BE, _ = robot.tool_poses(q_rad)
    return np.asarray((p_BE - robot.mount_p_BM_B_m) @ robot.mount_R_BM, dtype=np.float64)


def rotation_angles(R: FloatArray) -> FloatArray:
    """Return the angles [rad] of rotation matrices (k, 3, 3), exact near zero."""
    twice_sine = np.stack(
        [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=-1
    )
    twice_cosine = np.trace(R, axis1=1, axis2=2) - 1.0
    return np.asarray(np.arctan2(_norms(twice_sine), twice_cosine), dtype=np.float64)


def _range_ratio(robot: Robot, q: FloatArray) -> FloatArray:
    """Return how much of its half range each bounded joint uses, -1 to 1 within the limits."""
    bounded = np.isfinite(robot.upper_rad)
    lower, upper = robot.lower_rad[bounded], robot.upper_rad[bounded]
    return np.asarray((2.0 * q[:, bounded] - upper - lower) / (upper - lower), dtype=np.float64)


def _norms(x: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(x, axis=-1), dtype=np.float64)


def _most(x: FloatArray, bound: float) -> LimitCheck:
    value = float(np.abs(x).max(initial=0.0))
    return LimitCheck(value, bound, value <= bound, value / bound)


def _least(value: float, bound: float) -> LimitCheck:
    return LimitCheck(value, bound, value >= bound, bound / value if value > 0 else np.inf)


def _positive(value: float) -> LimitCheck:
    return LimitCheck(value, 0.0, value > 0, 0.0 if value > 0 else np.inf)
