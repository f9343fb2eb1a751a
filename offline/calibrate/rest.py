"""Calibration at rest: torque offsets, and biases of the inertial unit, from mean readings."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from scipy.spatial.transform import Rotation

from fsw.config import Config
from fsw.errors import EstimatorError
from fsw.estimators.conditioning.rotation import rotation_from_xyzw
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray, Window
from offline.calibrate.drift import LEAST_WINDOWS, drift
from offline.calibrate.figures import Figure, in_axes, sensor_axes, stated

MOVED_RAD = 1e-4  # a joint that moves by less is at rest: a controller never holds it exactly
SIGMAS = 6.0  # a reading at rest is never off by more sigmas of its noise
TURNING_RAD_S = 2e-3  # limit at rest: the centrifugal force on 100 kg at 1 m is then 4e-4 N
LEAST_SOLUTIONS = 10  # least number of the star tracker's solutions for a rate


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Expected:
    """Predicted readings at rest, each with the covariance of the prediction; vectors in B."""

    tau_nm: FloatArray  # (n,)
    tau_covariance: FloatArray  # (n, n)
    f_m_s2: FloatArray  # (3,)
    f_covariance: FloatArray
    w_rad_s: FloatArray  # (3,)
    w_covariance: FloatArray
    is_tracked: bool  # whether w_rad_s is from the star tracker


def rest_figures(
    config: Config, problem: Problem, windows: Sequence[Window], blocks: Sequence[Block]
) -> list[Figure]:
    """Return offsets and biases from a recording at rest.

    Torque and specific force are compared with the model's prediction at this posture: zero in free
    fall, the weights on the ground. The priors of bodies, scales, zeros and mounting make the
    prediction uncertain. The gyro is compared with the star tracker or else the prior's momentum.

    Raises
    ------
    EstimatorError if the recording is too short, or the robot moves.
    """
    if len(blocks) < LEAST_WINDOWS:
        window_s = config.estimator.window_s
        raise EstimatorError(
            f"{len(blocks)} usable windows at rest; must be {LEAST_WINDOWS} or more "
            f"({LEAST_WINDOWS * window_s:g} s)"
        )
    _at_rest(config, problem, blocks)
    expected = _expected(config, problem, windows, blocks)
    order = problem.model.joint_names
    joints = {joint.name: joint for joint in config.joints}
    found = []
    for k, name in enumerate(order):
        used = [block for block in blocks if block.has_joint[k]]
        if joints[name].torque == "none" or len(used) < LEAST_WINDOWS:
            continue
        level = drift(_means([b.tau_nm[:, k : k + 1] for b in used]), _noise(used[0].cov_tau[k]))
        sigma = np.hypot(level.sigma, np.sqrt(expected.tau_covariance[k, k]))
        found.append(
            Figure(
                kind="torque_offset",
                which=name,
                value=float(level.mean[0] - expected.tau_nm[k]),
                sigma=float(sigma),
                known=stated(joints[name].torque_offset_sigma_nm),
            )
        )
    if config.imu.present:
        found += _biases(config, blocks, expected)
    return found


def _biases(config: Config, blocks: Sequence[Block], expected: _Expected) -> list[Figure]:
    imu, R, found, m = config.imu, sensor_axes(config), list[Figure](), config.estimator.nodes
    turning = [block for block in blocks if block.has_gyro]
    if len(turning) >= LEAST_WINDOWS:
        noise = _noise(turning[0].cov_gyro[:m, :m])
        level = drift(_means([block.w_NB_B_rad_s for block in turning]), noise)
        most = SIGMAS * (level.white + (imu.gyro_bias_sigma_rad_s or level.white))
        swing = float(np.ptp(_means([block.w_NB_B_rad_s for block in turning]), axis=0).max())
        if swing > most:
            raise EstimatorError(
                f"the robot moves: the gyro's means over {config.estimator.window_s:g} s differ by "
                f"{swing:.2g} rad/s, noise and bias by {most:.2g} at most"
            )
        covariance = level.sigma**2 * np.eye(3) + expected.w_covariance
        known = stated(imu.gyro_bias_sigma_rad_s)
        _not_turning(level.mean, expected, SIGMAS * np.sqrt(known**2 + np.diag(covariance)))
        found += in_axes("gyro_bias", level.mean - expected.w_rad_s, covariance, R, known)
    pushed = [block for block in blocks if block.has_accelerometer]
    if len(pushed) >= LEAST_WINDOWS:
        level = drift(_means([b.f_NS_B_m_s2 for b in pushed]), _noise(pushed[0].cov_acc))
        covariance = level.sigma**2 * np.eye(3) + expected.f_covariance
        known = stated(imu.acc_bias_sigma_m_s2)
        found += in_axes("acc_bias", level.mean - expected.f_m_s2, covariance, R, known)
    return found


def _not_turning(reading: FloatArray, expected: _Expected, limits: FloatArray) -> None:
    """Raise EstimatorError if tracker or gyro show that the base turns.

    Parameters
    ----------
    reading, limits : (3,) mean rate of the gyro and its largest difference from the expected rate
    """
    turning = float(np.linalg.norm(expected.w_rad_s))
    if expected.is_tracked and turning > TURNING_RAD_S:
        raise EstimatorError(
            f"the robot moves: the base turns at {turning:.2g} rad/s by the star tracker, at rest "
            f"at {TURNING_RAD_S:g} at most"
        )
    off = np.abs(reading - expected.w_rad_s)
    if not expected.is_tracked and np.any(off > limits):
        axis = int(np.argmax(off / limits))
        raise EstimatorError(
            f"the robot moves: the gyro reads {off[axis]:.2g} rad/s about {'xyz'[axis]} of B, "
            f"noise and bias are {limits[axis]:.2g} at most; without a star tracker a base that "
            "turns cannot be distinguished from a bias"
        )


def _at_rest(config: Config, problem: Problem, blocks: Sequence[Block]) -> None:
    """Raise EstimatorError if a joint moves; the message states when the motion begins."""
    angles = np.array([block.q_rad.mean(axis=0) for block in blocks])
    noise = {joint.name: joint.position_noise_rad for joint in config.joints}
    start_ns = blocks[0].t_ns[0]
    for k, name in enumerate(problem.model.joint_names):
        off = np.abs(angles[:, k] - angles[0, k])
        limit = max(MOVED_RAD, SIGMAS * noise[name])
        if blocks[-1].walk_rad2.size:
            limit = max(limit, SIGMAS * float(np.sqrt(blocks[-1].walk_rad2[k])))
        if off.max() > limit:
            first = blocks[int(np.argmax(off > limit))]
            raise EstimatorError(
                f"the robot moves: {name} by {off.max():.2g} rad, at rest it is {limit:.2g} at "
                f"most, after {(first.t_ns[0] - start_ns) * 1e-9:.1f} s of these data; choose the "
                "part at rest by --from and --to"
            )


def _expected(
    config: Config, problem: Problem, windows: Sequence[Window], blocks: Sequence[Block]
) -> _Expected:
    """Return predicted readings without offsets and biases; the rate is the tracker's, if known."""
    x = problem.prior_mean
    at = predict(blocks[len(blocks) // 2], x, problem, "momentum")
    P = problem.prior_covariance.copy()
    for group in ("torque_offset", "acc_bias", "gyro_bias"):
        own = problem.at(group)
        P[own] = 0.0
        P[:, own] = 0.0
    J_tau, J_f, J_w = (J.mean(axis=0) for J in (at.J_tau, at.J_f, at.J_w))
    w, w_covariance = at.w_rad_s.mean(axis=0), J_w @ P @ J_w.T
    turned = None if config.star_tracker is None else _tracked(config, windows)
    if turned is not None:
        w, w_covariance = turned
    return _Expected(
        tau_nm=at.tau_nm.mean(axis=0),
        tau_covariance=J_tau @ P @ J_tau.T,
        f_m_s2=at.f_m_s2.mean(axis=0),
        f_covariance=J_f @ P @ J_f.T,
        w_rad_s=w,
        w_covariance=w_covariance,
        is_tracked=turned is not None,
    )


def _tracked(config: Config, windows: Sequence[Window]) -> tuple[FloatArray, FloatArray] | None:
    """Return the base's rate (3,) [rad/s] and covariance (3, 3), in B, from the star tracker.

    The rate is the slope of a line through the rotation vectors since the first solution, which
    are small at rest. None: there are too few solutions.
    """
    tracker = config.star_tracker
    t_ns = np.concatenate([window.attitude.t_ns for window in windows])
    if tracker is None or len(t_ns) < LEAST_SOLUTIONS:
        return None
    R_NB = Rotation.from_quat(np.concatenate([window.attitude.values for window in windows]))
    turns = (R_NB[0].inv() * R_NB).as_rotvec()
    t_s = (t_ns - t_ns.mean()) * 1e-9
    rate = t_s @ (turns - turns.mean(axis=0)) / (t_s @ t_s)
    noise = np.array([*(tracker.noise_across_rad,) * 2, tracker.noise_about_rad]) ** 2
    R_BS = rotation_from_xyzw(np.array(tracker.mounting.q_BS_xyzw))
    return rate, R_BS @ np.diag(noise / (t_s @ t_s)) @ R_BS.T


def _weights(nodes: int) -> FloatArray:
    """Return weights (nodes,) whose product with the values at the nodes is the window's mean."""
    return np.asarray(0.5 * legendre.leggauss(nodes)[1], np.float64)


def _means(values: Sequence[FloatArray]) -> FloatArray:
    """Return the means (n, k) of n windows with values (m, k) at the nodes."""
    found: FloatArray = np.einsum("m,nmk->nk", _weights(len(values[0])), np.array(values))
    return found


def _noise(covariance: FloatArray) -> float:
    """Return 1 sigma of a window's mean from the covariance (m, m) of the values at its nodes."""
    weights = _weights(len(covariance))
    return float(np.sqrt(weights @ covariance @ weights))
