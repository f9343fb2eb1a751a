"""Fisher information of raw samples with white noise, at the truth, channel by channel.

It is independent of the flight software: the bench's model (judge/bound.py) gives the derivatives
of the recursive Newton-Euler algorithm. The joint angles are noisy too: one polynomial per window
is fitted to the angles of a joint. The errors of the joint accelerations have a covariance C over
the window, which adds D C D^T to the covariance of every value predicted from the accelerations.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from evidence.methods.cases import NODES, RATE_HZ, SENSOR_SETS, WINDOW_S, scenario_of, truth_of
from evidence.methods.exact import exact_samples
from evidence.methods.sensed import ChannelNoise
from hil.judge.bound import Sensors, sensitivity
from hil.judge.floating import FloatingRobot
from hil.world.inertia import FloatArray, pi_of
from hil.world.sensor_config import SensorConfig
from hil.world.sensors import rotation_of

ALL = "all"
POSITION_DEGREE = NODES + 2  # of the polynomial of a joint's angles in a window


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Sensitivities at the truth along a motion: N samples, n joints, p unknown parameters."""

    J_tau: FloatArray  # (N, n, p) of the torques, with the base rate predicted from momentum
    J_tau_w: FloatArray  # (N, n, p) of the torques, with a given base rate
    J_acc: FloatArray  # (N, 3, p) of the accelerometer
    J_gyro: FloatArray  # (N, 3, p) of the gyro
    D_tau: FloatArray  # (N, n, n) of the torques by the joint accelerations
    D_acc: FloatArray  # (N, 3, n) of the accelerometer by the joint accelerations
    D_tau_w: FloatArray  # (N, n, 3) of the torques by a given base rate


@lru_cache(maxsize=3)
def sweep(case: str) -> Sweep:
    """Return the sensitivities at every sample of the motion of a case."""
    scenario = scenario_of(case)
    pis = {body: pi_of(report) for body, report in scenario.truth.items()}
    robot = FloatingRobot(scenario.urdf, scenario.tool_frame, pis, scenario.unknown)
    sensors, x = _sensors(case, robot.n), truth_of(case)
    samples = exact_samples(case)
    rows = [
        _row(robot, sensors, x, *state)
        for state in zip(samples.q, samples.qd, samples.qdd, strict=True)
    ]
    return Sweep(*(np.stack(column) for column in zip(*rows, strict=True)))


def _row(
    robot: FloatingRobot,
    sensors: Sensors,
    x: FloatArray,
    q: FloatArray,
    qd: FloatArray,
    qdd: FloatArray,
) -> tuple[FloatArray, ...]:
    """Return the sensitivities of `Sweep` at one sample."""
    pi = robot.stacked(x)
    s = sensitivity(robot, sensors, x, q, qd, qdd)
    w = sensors.R_BS @ s.w_NS_S_rad_s
    nu = np.concatenate((np.zeros(3), w, qd))
    held = np.concatenate((np.zeros(6), qdd))
    H = robot.derivatives(q, nu, held, pi)[2]
    a = -np.linalg.solve(H[:6, :6], (robot.regressor(q, nu, held) @ pi)[:6])
    full = np.concatenate((a, qdd))
    C_w = robot.derivatives(q, nu, full, pi)[1][:, 3:6]
    Y = robot.regressor(q, nu, full) @ robot.select
    N = -np.linalg.solve(H[:6, :6], H[:6, 6:])
    J_tau_w = Y[6:] - H[6:, :6] @ np.linalg.solve(H[:6, :6], Y[:6])
    D_w = C_w[6:] - H[6:, :6] @ np.linalg.solve(H[:6, :6], C_w[:6])
    lever = np.cross(N[3:].T, sensors.p_BS_m).T
    D_acc = sensors.R_BS.T @ (N[:3] + lever)
    D_tau = H[6:, 6:] + H[6:, :6] @ N
    return s.J_tau, J_tau_w, s.J_acc, s.J_gyro, D_tau, D_acc, D_w


@lru_cache(maxsize=64)
def information(
    case: str, sensors: str, channels: str, *, angles_exact: bool = False
) -> FloatArray:
    """Return the Fisher information (p, p) of the samples for one choice of channels.

    `channels`: all (torque, accelerometer, gyro), rda (torque at the measured rate), cm (gyro),
    torque (torque at the predicted rate). The inverse is the covariance of an efficient estimator
    with these channels and every window's angles alone; with `angles_exact`, of any estimator.
    """
    s, noise = sweep(case), SENSOR_SETS[sensors]
    J, D, variance, shared = _rows(s, noise, channels)
    k = round(WINDOW_S * RATE_HZ)
    C = (0.0 if angles_exact else noise.position_rad**2) * _acceleration_covariance(k)
    total = np.zeros((J.shape[2], J.shape[2]))
    r = J.shape[1]
    for first in range(0, len(J) - k + 1, k):
        part = slice(first, first + k)
        S = np.einsum("kri,kl,lsi->krls", D[part], C, D[part], optimize=True)
        at = np.arange(k)
        S[at, :, at, :] += np.diag(variance) + shared[part]
        rows = J[part].reshape(k * r, -1)
        total += rows.T @ np.linalg.solve(S.reshape(k * r, k * r), rows)
    return 0.5 * (total + total.T)


def bound(information_matrix: FloatArray) -> FloatArray:
    """Return the inverse of an information matrix, solved in unit-diagonal scaling."""
    scale = 1.0 / np.sqrt(np.diag(information_matrix))
    unit = np.linalg.solve(information_matrix * np.outer(scale, scale), np.eye(scale.size))
    scaled: FloatArray = unit * np.outer(scale, scale)
    return 0.5 * (scaled + scaled.T)


def _rows(
    s: Sweep, noise: ChannelNoise, channels: str
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return J (N, r, p), D (N, r, n), the channels' variances (r,), other noise (N, r, r)."""
    N, n = s.J_tau.shape[:2]
    tau = np.full(n, noise.torque_nm**2)
    gyro = np.full(3, noise.rate_rad_s**2)
    still = np.zeros((N, 3, n))  # noise of the angles has almost no effect on a predicted rate
    if channels == ALL:
        J = np.concatenate([s.J_tau, s.J_acc, s.J_gyro], axis=1)
        D = np.concatenate([s.D_tau, s.D_acc, still], axis=1)
        variance = np.concatenate([tau, np.full(3, noise.acceleration_m_s2**2), gyro])
        return J, D, variance, np.zeros((N, 1, 1))
    if channels == "rda":
        shared = noise.rate_rad_s**2 * s.D_tau_w @ s.D_tau_w.transpose(0, 2, 1)
        return s.J_tau_w, s.D_tau, tau, shared
    if channels == "torque":
        return s.J_tau, s.D_tau, tau, np.zeros((N, 1, 1))
    if channels == "cm":
        return s.J_gyro, still, gyro, np.zeros((N, 1, 1))
    raise ValueError(f"channels {channels!r} unknown")


def _acceleration_covariance(count: int) -> FloatArray:
    """Return the covariance (k, k) of a window's joint accelerations per unit of angle noise."""
    half = 0.5 * WINDOW_S
    at = (np.arange(count) + 0.5) / RATE_HZ / half - 1.0
    unit = np.eye(POSITION_DEGREE + 1)
    second = np.stack([legendre.legval(at, legendre.legder(c, 2)) for c in unit], axis=1) / half**2
    map_to = second @ np.linalg.pinv(legendre.legvander(at, POSITION_DEGREE))
    covariance: FloatArray = map_to @ map_to.T
    return covariance


def _sensors(case: str, n: int) -> Sensors:
    """Return sensors with unit noise, mounted as in the scenario of a case."""
    imu = SensorConfig.from_dict(scenario_of(case).sensors).imu
    if imu is None:
        raise ValueError("the bound needs an inertial unit")
    return Sensors(
        joint_rate_hz=RATE_HZ,
        torque_noise_nm=np.ones(n),
        torque_offset_sigma_nm=np.zeros(n),
        imu_rate_hz=RATE_HZ,
        gyro_noise_rad_s=1.0,
        gyro_bias_sigma_rad_s=0.0,
        acc_noise_m_s2=1.0,
        acc_bias_sigma_m_s2=0.0,
        p_BS_m=np.array(imu.p_BS_m),
        R_BS=rotation_of(imu.q_BS_xyzw),
    )
