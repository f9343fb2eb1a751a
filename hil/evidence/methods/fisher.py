"""Fisher information of white noise on the samples, at the truth, channel by channel.

Independent of the flight software: the bench's own model (Pinocchio regressors, derivatives of the
recursive Newton-Euler algorithm). Equations as in judge/bound.py; here with angular acceleration as
a channel of its own and with noisy joint accelerations or a measured rate as latent variables,
which add their image D Sigma D^T to the covariance of what is predicted from them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from hil.evidence.methods.cases import SENSOR_SETS, SensorSet, scenario_of, truth_of
from hil.evidence.methods.exact import exact_samples
from hil.judge.floating import FloatingRobot
from hil.world.inertia import FloatArray, pi_of

UNMODELLED_WRENCH = 1e-3  # N and N m, 1 sigma per sample: keeps MRNEA's covariance regular
ALL = "all"


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Sensitivities at the truth along a motion of N samples; p unknown parameters."""

    Y: FloatArray  # (N, 6+n, p) regressor at the true accelerations
    H: FloatArray  # (N, 6+n, 6+n)
    C_w: FloatArray  # (N, 6+n, 3) d(generalised force)/d w
    J_tau: FloatArray  # (N, n, p) with the rate predicted from momentum
    J_tau_w: FloatArray  # (N, n, p) at a given rate
    J_a: FloatArray  # (N, 6, p)
    J_w: FloatArray  # (N, 3, p)
    J_v: FloatArray  # (N, 3, p) base velocity
    N: FloatArray  # (N, 6, n) -H_bb^-1 H_bm


@lru_cache(maxsize=3)
def sweep(case: str) -> Sweep:
    """Evaluate the sensitivities at every sample of a case's motion."""
    scenario = scenario_of(case)
    pis = {body: pi_of(report) for body, report in scenario.truth.items()}
    robot = FloatingRobot(scenario.urdf, scenario.tool_frame, pis, scenario.unknown)
    x = truth_of(case)
    pi, U, n = robot.stacked(x), robot.select, robot.n
    samples = exact_samples(case)
    count, m, p = len(samples.t_s), 6 + n, x.size
    Y, Y_h = np.empty((count, m, p)), np.empty((count, 6, p))
    H, C = np.empty((count, m, m)), np.empty((count, m, 3))
    for i in range(count):
        q, qd, qdd = samples.q[i], samples.qd[i], samples.qdd[i]
        b = robot.mass_columns(q) @ pi
        twist = -np.linalg.solve(b[:6], robot.momentum(q, qd) @ pi)
        Y_h[i] = (robot.regressor(q, np.zeros(m), np.concatenate((twist, qd))) @ U)[:6]
        nu = np.concatenate((np.zeros(3), twist[3:], qd))
        held = np.concatenate((np.zeros(6), qdd))
        a = -np.linalg.solve(b[:6], (robot.regressor(q, nu, held) @ pi)[:6])
        full = np.concatenate((a, qdd))
        Y[i] = robot.regressor(q, nu, full) @ U
        C[i] = robot.bias_derivative(q, nu, full, pi)[:, 3:6]
        H[i] = _mass_matrix(robot, q)
    H_bb, H_bm = H[:, :6, :6], H[:, :6, 6:]
    J_nu = -_solve(H_bb, Y_h)
    J_w, J_v = J_nu[:, 3:], J_nu[:, :3]
    J_a = -_solve(H_bb, Y[:, :6] + C[:, :6] @ J_w)
    J_a_w = -_solve(H_bb, Y[:, :6])
    H_mb = H_bm.transpose(0, 2, 1)
    return Sweep(
        Y=Y,
        H=H,
        C_w=C,
        J_tau=Y[:, 6:] + C[:, 6:] @ J_w + H_mb @ J_a,
        J_tau_w=Y[:, 6:] + H_mb @ J_a_w,
        J_a=J_a,
        J_w=J_w,
        J_v=J_v,
        N=-_solve(H_bb, H_bm),
    )


def information(case: str, sensors: str, channels: str) -> FloatArray:
    """Return the Fisher information (p, p) of the samples for one choice of channels.

    `channels`: all (torque, linear and angular acceleration, rate), fused (without angular
    acceleration), mrnea (all, but not the law of momentum), rda (torque at the measured rate), cm
    (rate), cm with v_b (rate and base velocity), torque (torque at the predicted rate). An
    efficient estimator of that choice reaches its inverse.
    """
    s, noise = sweep(case), SENSOR_SETS[sensors]
    parts = _parts(s, noise, channels)
    p = s.Y.shape[2]
    total = np.zeros((p, p))
    for J, S in parts:
        total += np.einsum("irp,irq->pq", J, np.linalg.solve(S, J), optimize=True)
    return 0.5 * (total + total.T)


def bound(information_matrix: FloatArray) -> FloatArray:
    """Return the inverse of an information matrix, solved in unit-diagonal scaling."""
    scale = 1.0 / np.sqrt(np.diag(information_matrix))
    unit = np.linalg.solve(information_matrix * np.outer(scale, scale), np.eye(scale.size))
    scaled: FloatArray = unit * np.outer(scale, scale)
    return 0.5 * (scaled + scaled.T)


def _parts(s: Sweep, noise: SensorSet, channels: str) -> list[tuple[FloatArray, FloatArray]]:
    """Return Jacobians (N, r, p) and covariances (N, r, r) of independent groups of rows."""
    count, n = s.J_tau.shape[:2]
    H_mb = s.H[:, 6:, :6]
    H_hat = s.H[:, 6:, 6:] + H_mb @ s.N
    tau, qdd = noise.torque_nm**2 * np.eye(n), noise.qdd_rad_s2**2
    rate = np.broadcast_to(noise.rate_rad_s**2 * np.eye(3), (count, 3, 3))
    acceleration = np.repeat([noise.acceleration_m_s2**2, noise.angular_acceleration_rad_s2**2], 3)
    if channels in (ALL, "fused"):
        width = 6 if channels == ALL else 3
        D = np.concatenate([H_hat, s.N[:, :width]], axis=1)
        S = qdd * D @ D.transpose(0, 2, 1)
        S[:, :n, :n] += tau
        S[:, n:, n:] += np.diag(acceleration[:width])
        return [(np.concatenate([s.J_tau, s.J_a[:, :width]], axis=1), S), (s.J_w, rate)]
    if channels == "rda":
        D_w = s.C_w[:, 6:] - H_mb @ np.linalg.solve(s.H[:, :6, :6], s.C_w[:, :6])
        S = qdd * H_hat @ H_hat.transpose(0, 2, 1) + tau
        S = S + noise.rate_rad_s**2 * D_w @ D_w.transpose(0, 2, 1)
        return [(s.J_tau_w, S)]
    if channels == "torque":
        return [(s.J_tau, qdd * H_hat @ H_hat.transpose(0, 2, 1) + tau)]
    if channels == "cm":
        return [(s.J_w, rate)]
    if channels == "cm with v_b":
        speed = np.broadcast_to(noise.velocity_m_s**2 * np.eye(3), (count, 3, 3))
        return [(s.J_w, rate), (s.J_v, speed)]
    if channels == "mrnea":
        variances = np.concatenate([acceleration, np.full(n, qdd)])
        S = (s.H * variances) @ s.H + noise.rate_rad_s**2 * s.C_w @ s.C_w.transpose(0, 2, 1)
        S[:, 6:, 6:] += tau
        S[:, :6, :6] += UNMODELLED_WRENCH**2 * np.eye(6)
        return [(s.Y, S)]
    raise ValueError(f"channels {channels!r} unknown")


def _solve(A: FloatArray, B: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(A, B), dtype=np.float64)


def _mass_matrix(robot: FloatingRobot, q: FloatArray) -> FloatArray:
    """Return H (6 + n, 6 + n) of the parameters `bias_derivative` was last given."""
    full = np.concatenate((pin.neutral(robot.model)[:7], q))
    upper = np.triu(pin.crba(robot.model, robot.data, full))
    return np.asarray(upper + np.triu(upper, 1).T)
