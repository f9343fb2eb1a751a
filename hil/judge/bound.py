"""Cramer-Rao bound of the unknown bodies for one run's true motion.

Torque sensors, accelerometer and gyro have white noise at their native rates. Torque offsets and
inertial biases are states with priors; encoders are exact; the momentum is zero. The Fisher
information is the sum over samples of J^T R^-1 J plus the information of the priors.

Predictions as functions of pi:  w = [-H_bb^-1 H_bm qd]_w,  a = -H_bb^-1 (c_b + H_bm qdd),
tau = rows 6: of Y(q, nu, [a; qdd]) pi, with nu = [0, w, qd] (nothing depends on v_b) and
a the classical acceleration of the base origin. Total derivatives (w depends on pi, too):

    J_nu = -H_bb^-1 Y(q, 0, nu_full)_b,  J_a = -H_bb^-1 (Y_b + D_b J_w),
    J_tau = Y_m + H_mb J_a + D_m J_w,  D = d(generalised force)/d w

Source: Rackl, Lampariello, Albu-Schaeffer (2013), eqs. (2), (22)-(23), (30), differentiated.
"""

from dataclasses import dataclass

import numpy as np

from hil.judge.floating import FloatingRobot
from hil.world.inertia import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensors:
    """White noise per sample, rates, and prior sigmas of offsets and biases (0: known exactly)."""

    joint_rate_hz: float
    torque_noise_nm: FloatArray  # (n,)
    torque_offset_sigma_nm: FloatArray  # (n,)
    imu_rate_hz: float
    gyro_noise_rad_s: float
    gyro_bias_sigma_rad_s: float
    acc_noise_m_s2: float
    acc_bias_sigma_m_s2: float
    p_BS_m: FloatArray  # (3,) accelerometer in B
    R_BS: FloatArray  # (3, 3)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivity:
    """Predictions at one instant, and their derivatives by the unknown bodies' parameters x."""

    tau_nm: FloatArray  # (n,)
    w_NS_S_rad_s: FloatArray  # (3,)
    f_NS_S_m_s2: FloatArray  # (3,)
    J_tau: FloatArray  # (n, p)
    J_gyro: FloatArray  # (3, p)
    J_acc: FloatArray  # (3, p)


def sensitivity(
    robot: FloatingRobot,
    sensors: Sensors,
    x: FloatArray,
    q: FloatArray,
    qd: FloatArray,
    qdd: FloatArray,
) -> Sensitivity:
    """Return predictions and exact Jacobians at x (p,) for one joint state (rad, rad/s, rad/s2)."""
    pi = robot.stacked(x)
    H_b = robot.mass_columns(q) @ pi  # (6 + n, 6)
    H_bb, H_mb = H_b[:6], H_b[6:]
    twist = -robot.give(H_bb, robot.momentum(q, qd) @ pi)
    momentum_rows = robot.regressor(q, np.zeros(6 + robot.n), np.concatenate((twist, qd)))[:6]
    J_twist = -robot.give(H_bb, momentum_rows @ robot.select)
    w, J_w = twist[3:], J_twist[3:]
    nu = np.concatenate((np.zeros(3), w, qd))
    held = np.concatenate((robot.support, qdd))
    a = robot.support - robot.give(H_bb, (robot.regressor(q, nu, held) @ pi)[:6])
    full = np.concatenate((a, qdd))
    Y = robot.regressor(q, nu, full)
    D = robot.bias_derivative(q, nu, full, pi)[:, 3:6]
    free = Y @ robot.select + D @ J_w
    J_a = -robot.give(H_bb, free[:6])
    J_tau = free[6:] + H_mb @ J_a
    r, R_SB = sensors.p_BS_m, sensors.R_BS.T
    wd, J_wd = a[3:], J_a[3:]
    force = a[:3] + np.cross(wd, r) + np.cross(w, np.cross(w, r))
    centripetal = (w @ r) * np.eye(3) + np.outer(w, r) - 2 * np.outer(r, w)
    J_force = J_a[:3] - _cross_matrix(r) @ J_wd + centripetal @ J_w
    return Sensitivity(
        tau_nm=(Y @ pi)[6:],
        w_NS_S_rad_s=R_SB @ w,
        f_NS_S_m_s2=R_SB @ force,
        J_tau=J_tau,
        J_gyro=R_SB @ J_w,
        J_acc=R_SB @ J_force,
    )


def information(
    robot: FloatingRobot,
    sensors: Sensors,
    x: FloatArray,
    motion: tuple[FloatArray, FloatArray, FloatArray],
    rate_hz: float,
) -> FloatArray:
    """Return the Fisher information (p, p) of x from a motion (q, qd, qdd) sampled at `rate_hz`.

    Offsets and biases are marginalised with their priors. Each instant counts as
    (native rate / rate_hz) samples of each sensor.
    """
    n, p = robot.n, x.size
    size = p + n + 6
    total = np.zeros((size, size))
    groups = (
        (slice(p, p + n), sensors.torque_offset_sigma_nm),
        (slice(p + n, p + n + 3), np.full(3, sensors.acc_bias_sigma_m_s2)),
        (slice(p + n + 3, size), np.full(3, sensors.gyro_bias_sigma_rad_s)),
    )
    weights = (
        sensors.joint_rate_hz / rate_hz / sensors.torque_noise_nm**2,
        np.full(3, sensors.imu_rate_hz / rate_hz / sensors.acc_noise_m_s2**2),
        np.full(3, sensors.imu_rate_hz / rate_hz / sensors.gyro_noise_rad_s**2),
    )
    for state in zip(*motion, strict=True):
        s = sensitivity(robot, sensors, x, *state)
        for J, weight, (columns, _) in zip(
            (s.J_tau, s.J_acc, s.J_gyro), weights, groups, strict=True
        ):
            total[:p, :p] += J.T @ (weight[:, None] * J)
            total[:p, columns] += J.T * weight
            total[columns, columns] += np.diag(weight)
    known: list[int] = []
    for columns, sigma in groups:
        indices = np.arange(columns.start, columns.stop)
        known += indices[sigma == 0].tolist()
        free = indices[sigma > 0]
        total[free, free] += 1.0 / sigma[sigma > 0] ** 2
    keep = np.array([k for k in range(p, size) if k not in known], dtype=int)
    if keep.size == 0:
        return np.asarray(total[:p, :p])
    cross = total[:p][:, keep]
    return np.asarray(total[:p, :p] - cross @ np.linalg.solve(total[np.ix_(keep, keep)], cross.T))


def _cross_matrix(v: FloatArray) -> FloatArray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
