"""Deviations from the configuration: joint angles, the inertial unit's attitude and its gyro."""

import numpy as np

from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.model.inertia import skew
from fsw.estimators.model.problem import Problem
from fsw.messages import FloatArray

LEANING = (np.array([0, 0, 1]), np.array([1, 2, 2]))  # pairs of axes: xy, xz, yz
SMALL = 1e-6  # rad: below, the series' first terms are exact in double precision


def turn(x: FloatArray, problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Return R (3, 3), from configured axes to true ones, and D (3, 3): d(R v) = -[R v x] D dx.

    Source: exponential map and left Jacobian of SO(3), Barfoot, State Estimation for Robotics
    (2017), eqs. (6.86), (7.76).
    """
    if not problem.has("imu_angle"):
        return np.eye(3), np.eye(3)
    phi = x[problem.at("imu_angle")]
    angle, K = float(np.linalg.norm(phi)), skew(phi)
    if angle < SMALL:
        return np.eye(3) + K + 0.5 * K @ K, np.eye(3) + 0.5 * K + K @ K / 6.0
    s, c = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
    R = np.eye(3) + s * K + c * K @ K
    return R, np.eye(3) + c * K + (1.0 - s) / angle**2 * K @ K


def gyro_turn(x: FloatArray, problem: Problem) -> FloatArray:
    """Return T (3, 3), from the gyro's reading minus its bias to the true rate, both in base axes.

    T = R R_BS (1 + E) R_BS^T. The symmetric E holds the scale errors of the axes and the angles by
    which two axes lean to one another. A turn of all three axes is part of the mounting.
    """
    R = turn(x, problem)[0]
    if not (problem.has("gyro_scale") or problem.has("gyro_axes")):
        return R
    E = np.zeros((3, 3))
    if problem.has("gyro_scale"):
        E += np.diag(x[problem.at("gyro_scale")])
    if problem.has("gyro_axes"):
        E[LEANING] = x[problem.at("gyro_axes")]
        E[LEANING[::-1]] = x[problem.at("gyro_axes")]
    return np.asarray(R + R @ problem.R_BS @ E @ problem.R_BS.T, np.float64)


def fill_gyro_columns(
    J: FloatArray, by_rate: FloatArray, w: FloatArray, x: FloatArray, problem: Problem
) -> None:
    """Add to J (N, r, p) the derivatives by the gyro's scales and axes, through the true rate.

    Parameters
    ----------
    by_rate : (N, r, 3) derivative by the true rate, or by its own derivative
    w : (N, 3) the true rate, or its derivative, at the state x
    """
    if not (problem.has("gyro_scale") or problem.has("gyro_axes")):
        return
    read = np.linalg.solve(gyro_turn(x, problem), w.T).T @ problem.R_BS  # along the unit's axes
    gain = by_rate @ (turn(x, problem)[0] @ problem.R_BS)
    if problem.has("gyro_scale"):
        J[:, :, problem.at("gyro_scale")] += gain * read[:, None]
    if problem.has("gyro_axes"):
        for one, other in (LEANING, LEANING[::-1]):
            J[:, :, problem.at("gyro_axes")] += gain[:, :, one] * read[:, None, other]


def as_true(s: BlockStack, x: FloatArray, problem: Problem) -> BlockStack:
    """Return the blocks with the joints' motion corrected by scales, zeros, walks and delays."""
    if problem.has("joint_scale") and x[problem.at("joint_scale")].any():
        s = s.scaled(1.0 + x[problem.at("joint_scale")])
    if problem.walks is not None:
        walked = problem.walks.moved(x[problem.at("joint_walk")], s.walks_at_nodes)
        s = s.shifted(x[problem.at("joint_zero")] + walked)
    elif problem.has("joint_zero") and x[problem.at("joint_zero")].any():
        s = s.shifted(x[problem.at("joint_zero")])
    if problem.delays.moves_joints and x[problem.delays.states].any():
        motion = s.q_rad, s.qd_rad_s, s.qdd_rad_s2
        s = s.moved(*problem.delays.advanced(x, *motion, s.m))
    return s


def needs_angle_columns(problem: Problem) -> bool:
    """Return whether states act through the joints' angles, besides walks and modes."""
    own = problem.has("joint_zero") or problem.has("joint_scale")
    return own or problem.delays.moves_joints


def fill_angle_columns(
    J: FloatArray,
    D: tuple[FloatArray, FloatArray, FloatArray],
    s: BlockStack,
    x: FloatArray,
    problem: Problem,
) -> None:
    """Add to J (N, r, p) the derivatives by scales, zeros, walks and delays of the joints' angles.

    `D` are the derivatives (N, r, n) by angles, rates and accelerations; `s` has the true motion.
    """
    D_q, zeros, scales = D[0], problem.at("joint_zero"), problem.at("joint_scale")
    if problem.has("joint_zero"):
        J[:, :, zeros] += D_q
    if problem.has("joint_scale"):
        zero = x[zeros] if problem.has("joint_zero") else 0.0
        motion = s.q_rad - zero, s.qd_rad_s, s.qdd_rad_s2
        whole = sum(gains * own[:, None] for gains, own in zip(D, motion, strict=True))
        J[:, :, scales] += whole / (1.0 + x[scales])
    if problem.walks is not None:
        shares = problem.walks.shares(s.walks_at_nodes)
        own = D_q[:, :, problem.walks.joints, None] * shares[:, None]
        J[:, :, problem.at("joint_walk")] += own.reshape(*D_q.shape[:2], -1)
    if problem.delays.moves_joints:
        by_delay = problem.delays.by_motion(D, (s.qd_rad_s, s.qdd_rad_s2), s.m)
        J[:, :, problem.delays.states] += by_delay


def with_bridges(s: BlockStack, problem: Problem) -> BlockStack:
    """Return the blocks with the variance of walks outside their steps added to the angles'."""
    if problem.walks is None:
        return s
    beside = np.zeros((len(s.blocks), s.n))
    beside[:, problem.walks.joints] = problem.walks.beside(s.walk_rad2)
    return s.doubted(beside)
