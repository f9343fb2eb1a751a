"""Cramer-Rao bound of the unknown bodies for one run's true motion.

Torque sensors, accelerometer and gyro have white noise at their native rates. Torque offsets and
scales, inertial biases and a constant momentum are states with priors. The Fisher information is
the sum over samples of J^T R^-1 J plus the information of the priors. The joints' motion is known
exactly, or unknown and shown by the encoders (see `unknown_motion`).

Predictions as functions of pi:  w = [-H_bb^-1 H_bm qd]_w,  a = -H_bb^-1 (c_b + H_bm qdd),
tau = rows 6: of Y(q, nu, [a; qdd]) pi, with nu = [0, w, qd] (nothing depends on v_b) and
a the classical acceleration of the base origin. Total derivatives (w depends on pi, too):

    J_nu = -H_bb^-1 Y(q, 0, nu_full)_b,  J_a = -H_bb^-1 (Y_b + D_b J_w),
    J_tau = Y_m + H_mb J_a + D_m J_w,  D = d(generalised force)/d w

The derivatives by q, qd and qdd, and by the angular momentum, follow in the same way: the direct
derivatives of generalised force and of the momentum H nu stand in place of Y and of Y(q, 0, nu).

What moves the base besides the arm (wheels, thrusters, a rate at the start) enters by the wrench on
the base and the momentum that it causes, both from the truth; what is not known of them is a state
with a prior (see `applied`).

Source: Rackl, Lampariello, Albu-Schaeffer (2013), eqs. (2), (22)-(23), (30), differentiated.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.judge.applied import NOTHING, Applied, Doubt
from hil.judge.floating import FloatingRobot
from hil.judge.unknown_motion import Encoders, UnknownMotion
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
    torque_scale_sigma: float = 0.0  # of every joint, relative
    momentum_sigma_nms: float = 0.0  # of each axis, constant in inertial space


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivity:
    """Predictions at one instant, and their derivatives by the unknown bodies' parameters x."""

    tau_nm: FloatArray  # (n,)
    w_NS_S_rad_s: FloatArray  # (3,)
    f_NS_S_m_s2: FloatArray  # (3,)
    J_tau: FloatArray  # (n, p)
    J_gyro: FloatArray  # (3, p)
    J_acc: FloatArray  # (3, p)
    by_motion: FloatArray  # (n + 6, 3 n): d[tau; f; w]/d[q; qd; qdd]
    by_momentum: FloatArray  # (n + 6, 6): the same by the momentum in B [N s, N m s]
    by_wrench: FloatArray  # (n + 6, 6): the same by the wrench on the base in B [N, N m]


def sensitivity(
    robot: FloatingRobot,
    sensors: Sensors,
    x: FloatArray,
    q: FloatArray,
    qd: FloatArray,
    qdd: FloatArray,
    applied: Applied = NOTHING,
) -> Sensitivity:
    """Return predictions and Jacobians at x (p,) for one joint state (rad, rad/s, rad/s2).

    They are exact for a wrench and a momentum in `applied` that do not depend on x. The gyroscopic
    wrench of wheels does, by the base's rate.
    """
    pi, p, n = robot.stacked(x), len(x), robot.n
    H_b = robot.mass_columns(q) @ pi  # (6 + n, 6)
    H_bb, H_mb = H_b[:6], H_b[6:]
    twist = robot.give(H_bb, applied.momentum - robot.momentum(q, qd) @ pi)
    rates = np.concatenate((twist, qd))
    still = np.zeros(6 + n)
    momentum_by_x = robot.regressor(q, still, rates)[:6] @ robot.select
    H_by_q, _, H = robot.derivatives(q, still, rates, pi)
    none, unit = np.zeros((6 + n, 6)), np.eye(6 + n, 6)
    by_q_qd_qdd = (H_by_q[:6], H[:6, 6:], np.zeros((6, n)))
    J_twist = -robot.give(H_bb, np.hstack((momentum_by_x, *by_q_qd_qdd, -unit[:6], none[:6])))
    w, J_w = twist[3:], J_twist[3:]
    nu = np.concatenate((np.zeros(3), w, qd))
    held = np.concatenate((robot.support, qdd))
    a = robot.support + robot.give(H_bb, applied.wrench - (robot.regressor(q, nu, held) @ pi)[:6])
    full = np.concatenate((a, qdd))
    Y = robot.regressor(q, nu, full)
    by_q, by_nu, _ = robot.derivatives(q, nu, full, pi)
    free = np.hstack((Y @ robot.select, by_q, by_nu[:, 6:], H[:, 6:], none, -unit))
    free += by_nu[:, 3:6] @ J_w
    J_a = -robot.give(H_bb, free[:6])
    J_tau = free[6:] + H_mb @ J_a
    r, R_SB = sensors.p_BS_m, sensors.R_BS.T
    wd, J_wd = a[3:], J_a[3:]
    force = a[:3] + np.cross(wd, r) + np.cross(w, np.cross(w, r))
    centripetal = (w @ r) * np.eye(3) + np.outer(w, r) - 2 * np.outer(r, w)
    J_force = J_a[:3] - _cross_matrix(r) @ J_wd + centripetal @ J_w
    J = np.vstack((J_tau, R_SB @ J_force, R_SB @ J_w))
    return Sensitivity(
        tau_nm=(Y @ pi)[6:],
        w_NS_S_rad_s=R_SB @ w,
        f_NS_S_m_s2=R_SB @ force,
        J_tau=J[:n, :p],
        J_gyro=J[n + 3 :, :p],
        J_acc=J[n : n + 3, :p],
        by_motion=J[:, p : p + 3 * n],
        by_momentum=J[:, p + 3 * n : p + 3 * n + 6],
        by_wrench=J[:, p + 3 * n + 6 :],
    )


def information(
    robot: FloatingRobot,
    sensors: Sensors,
    x: FloatArray,
    motion: tuple[FloatArray, FloatArray, FloatArray],
    rate_hz: float,
) -> FloatArray:
    """Return `Summed.information` for a motion (q, qd, qdd) that is known exactly."""
    return Summed(robot, sensors, x, motion, rate_hz).information()


class Summed:
    """Information about x, nuisances and motion, summed over a motion sampled at `rate_hz`.

    Each instant counts as (native rate / rate_hz) samples of each sensor.

    Parameters
    ----------
    motion : true (q, qd, qdd)
    R_NB : (k, 3, 3) attitude of the base, needed for a momentum only; None: constant
    applied : (k,) what acts on the base; None: nothing
    doubts : unknown errors of what acts on the base
    encoders : what shows the joints' motion; None: it is known exactly
    """

    def __init__(
        self,
        robot: FloatingRobot,
        sensors: Sensors,
        x: FloatArray,
        motion: tuple[FloatArray, FloatArray, FloatArray],
        rate_hz: float,
        R_NB: FloatArray | None = None,
        encoders: Encoders | None = None,
        applied: Sequence[Applied] | None = None,
        doubts: Sequence[Doubt] = (),
    ) -> None:
        n, p = robot.n, x.size
        sigmas = np.array([doubt.sigma for doubt in doubts])
        self._p, self._prior = p, np.concatenate((_prior_sigmas(sensors), sigmas))
        size = p + self._prior.size
        of_imu = sensors.imu_rate_hz / rate_hz
        weights = np.concatenate(
            (
                sensors.joint_rate_hz / rate_hz / sensors.torque_noise_nm**2,
                np.full(3, of_imu / sensors.acc_noise_m_s2**2),
                np.full(3, of_imu / sensors.gyro_noise_rad_s**2),
            )
        )
        attitudes = np.broadcast_to(np.eye(3), (len(motion[0]), 3, 3)) if R_NB is None else R_NB
        self._total = np.zeros((size, size))
        count = len(motion[0])
        self._motion = None if encoders is None else UnknownMotion(encoders, count, rate_hz, size)
        on_base = [NOTHING] * count if applied is None else applied
        for k, state in enumerate(zip(*motion, on_base, strict=True)):
            s = sensitivity(robot, sensors, x, *state)
            A = np.zeros((n + 6, size))
            A[:, :p] = np.vstack((s.J_tau, s.J_acc, s.J_gyro))
            A[:, p : p + n + 6] = np.eye(n + 6)
            A[:n, p + n + 6 : p + 2 * n + 6] = np.diag(s.tau_nm)
            A[:, p + 2 * n + 6 : p + 2 * n + 9] = s.by_momentum[:, 3:] @ attitudes[k].T
            for place, doubt in enumerate(doubts, p + 2 * n + 9):
                A[:, place] = s.by_wrench @ doubt.wrench[k] + s.by_momentum @ doubt.momentum[k]
            self._total += A.T @ (weights[:, None] * A)
            if self._motion is not None:
                self._motion.add(k, A, s.by_motion, weights)

    def information(self, *, motion_known: bool = True) -> FloatArray:
        """Return the Fisher information (p, p) of x, nuisances marginalised with their priors."""
        total, p, prior = self._total.copy(), self._p, self._prior
        if not motion_known and self._motion is not None:
            total -= self._motion.cost()
        known = p + np.flatnonzero(prior == 0.0)
        free = p + np.flatnonzero(prior > 0.0)
        total[free, free] += 1.0 / prior[free - p] ** 2
        total = np.delete(np.delete(total, known, 0), known, 1)
        own, cross = total[:p, :p], total[:p, p:]
        return np.asarray(own - cross @ np.linalg.solve(total[p:, p:], cross.T))


def _prior_sigmas(sensors: Sensors) -> FloatArray:
    """Return the prior sigmas of offsets, biases, scales and momentum; 0: known exactly."""
    return np.concatenate(
        (
            sensors.torque_offset_sigma_nm,
            np.full(3, sensors.acc_bias_sigma_m_s2),
            np.full(3, sensors.gyro_bias_sigma_rad_s),
            np.full(len(sensors.torque_noise_nm), sensors.torque_scale_sigma),
            np.full(3, sensors.momentum_sigma_nms),
        )
    )


def _cross_matrix(v: FloatArray) -> FloatArray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
