"""How much a joint motion would tell and how near it comes to the limits, by a light model.

Zero momentum gives the base motion without integration of dynamics: v_b = -H_bb^-1 H_bm theta_dot,
a_b = -H_bb^-1 (c_b + H_bm theta_ddot). Pinocchio is used here only to choose trajectories; what is
chosen is confirmed in the truth (MuJoCo).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import Rotation

from hil.world.limits import Limits
from hil.world.robot import Body
from hil.world.spline import JointSpline

FloatArray = NDArray[np.float64]

# White-noise densities of the sensors a motion is judged for: 0.05 N m at 500 Hz, and a
# tactical-grade inertial unit.
TORQUE_NM_SQRT_S = 0.05 / 500**0.5
ACCELERATION_M_S2_SQRT_S = 5e-4
RATE_RAD_S_SQRT_S = 4.4e-5
PRIOR_RATIO = 0.3
STEP_S = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """Robot model of the light computation and the bodies whose information counts."""

    model: pin.Model
    tool_id: int
    columns: NDArray[np.intp]  # of the joint-torque regressor
    prior: FloatArray  # information of a wide prior, diagonal

    @property
    def lower_rad(self) -> FloatArray:
        """Lower joint limits, (n,)."""
        return np.array(self.model.lowerPositionLimit[7:])

    @property
    def upper_rad(self) -> FloatArray:
        """Upper joint limits, (n,)."""
        return np.array(self.model.upperPositionLimit[7:])


@dataclass(frozen=True, slots=True)
class Probe:
    """Largest share of any limit used, and the log-determinant of the information."""

    ratio: float
    information_nats: float


def subject(urdf: Path, tool_frame: str, target: Body | None, unknown: tuple[str, ...]) -> Subject:
    """Build the light model; `unknown` names the bodies ("base", "target") that shall be seen."""
    model = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
    model.gravity.setZero()
    tool_id = model.getFrameId(tool_frame)
    frame = model.frames[tool_id]
    scales = {"base": float(model.inertias[1].mass)}
    if target is not None:
        xx, xy, xz, yy, yz, zz = target.inertia_kg_m2
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        body = pin.Inertia(target.mass_kg, np.array(target.com_m), inertia)
        model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
        scales["target"] = target.mass_kg
    first = {"base": 0, "target": 10 * (frame.parentJoint - 1)}
    columns = np.concatenate([first[name] + np.arange(10) for name in unknown])
    prior = np.concatenate([np.full(10, (PRIOR_RATIO * scales[name]) ** -2) for name in unknown])
    return Subject(model=model, tool_id=tool_id, columns=columns, prior=prior)


def probe(robot: Subject, spline: JointSpline, limits: Limits) -> Probe:
    """Evaluate a motion at coarse steps.

    The information is that of torque, angular rate and specific force together, each with an
    unknown constant offset (its column means are removed).
    """
    t = np.arange(0.5 * STEP_S, spline.duration_s, STEP_S)
    q, qd, qdd = spline.evaluate(t)
    used = [
        np.abs(2 * q - robot.upper_rad - robot.lower_rad) / (robot.upper_rad - robot.lower_rad),
        np.abs(qd) / limits.joint_speed_rad_s,
        np.abs(qdd) / limits.joint_acceleration_rad_s2,
    ]
    data = robot.model.createData()
    n, p = spline.n, len(robot.columns)
    tau = np.empty((len(t), n))
    base = np.empty((len(t), 12))
    tool = np.empty((len(t), 3))
    J = np.empty((len(t), n + 6, p))
    for k in range(len(t)):
        tau[k], base[k], J[k] = _sample(robot, data, q[k], qd[k], qdd[k])
        pin.forwardKinematics(robot.model, data, _pose(q[k]))
        tool[k] = pin.updateFramePlacement(robot.model, data, robot.tool_id).translation
    mount = np.array(robot.model.jointPlacements[2].translation)
    tool = (tool - mount) @ robot.model.jointPlacements[2].rotation
    distance = np.linalg.norm(tool, axis=1)
    used += [
        np.abs(tau) / limits.torque_nm,
        np.linalg.norm(base[:, 3:6], axis=1) / limits.base_rate_rad_s,
        np.linalg.norm(base[:, 9:12], axis=1) / limits.base_acceleration_rad_s2,
        _excursion(base[:, 3:6]) / limits.attitude_rad,
        np.abs(tool[:, :2]) / limits.tool_box_m,
        limits.tool_distance_m / distance,
        np.where(tool[:, 2] > 0, 0.0, np.inf),
    ]
    J -= J.mean(axis=0)
    stacked = J.reshape(-1, p)
    fisher = STEP_S * stacked.T @ stacked + np.diag(robot.prior)
    scale = 1.0 / np.sqrt(robot.prior)
    _, logdet = np.linalg.slogdet(fisher * scale[:, None] * scale)
    return Probe(max(float(x.max()) for x in used), 0.5 * float(logdet))


def _pose(q: FloatArray) -> FloatArray:
    return np.concatenate([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], q])


def _sample(
    robot: Subject, data: pin.Data, q: FloatArray, qd: FloatArray, qdd: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Torques, base velocity and acceleration, and the whitened Jacobian of all channels."""
    model, pose = robot.model, _pose(q)
    upper = np.triu(pin.crba(model, data, pose))
    H = upper + np.triu(upper, 1).T
    factor = cho_factor(H[:6, :6], check_finite=False)
    nu = -cho_solve(factor, H[:6, 6:] @ qd, check_finite=False)
    v = np.concatenate([[0.0, 0.0, 0.0], nu[3:], qd])
    c = pin.nonLinearEffects(model, data, pose, v)
    a = -cho_solve(factor, c[:6] + H[:6, 6:] @ qdd, check_finite=False)
    tau = H[6:, :6] @ a + H[6:, 6:] @ qdd + c[6:]
    accelerations = np.concatenate([a, qdd])
    Y = pin.computeJointTorqueRegressor(model, data, pose, v, accelerations)[:, robot.columns]
    velocities = np.concatenate([nu, qd])
    zero = np.zeros(len(v))
    momentum = pin.computeJointTorqueRegressor(model, data, pose, zero, velocities)
    J_a = -cho_solve(factor, Y[:6], check_finite=False)
    J_nu = -cho_solve(factor, momentum[:6, robot.columns], check_finite=False)
    J = [
        (Y[6:] + H[6:, :6] @ J_a) / TORQUE_NM_SQRT_S,
        J_a[:3] / ACCELERATION_M_S2_SQRT_S,
        J_nu[3:] / RATE_RAD_S_SQRT_S,
    ]
    return tau, np.concatenate([nu, a]), np.concatenate(J)


def _excursion(w_B: FloatArray) -> FloatArray:
    """Angle turned since the start, from body rates at the middle of equal steps."""
    turn = Rotation.identity()
    angles = np.empty(len(w_B))
    for k, w in enumerate(w_B):
        turn = turn * Rotation.from_rotvec(STEP_S * w)
        angles[k] = turn.magnitude()
    return angles
