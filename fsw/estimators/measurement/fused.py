"""The fused measurement model: torque, accelerometer and gyro predicted from joint motion alone.

At zero (or known, or estimated) momentum the base's whole motion follows from the arm's, so the
prediction needs no base measurement and no v_b; gyro and accelerometer are pure measurements. Every
Jacobian is exact and comes from two regressors and one 6 x 6 factorisation per node:

    w     = [-H_bb^-1 H_bm qd + H_bb^-1 [0; L_B]]_3:6               J_nu = -H_bb^-1 Y_h
    a_b   = -H_bb^-1 (c_b + H_bm qdd)                               J_a  = -H_bb^-1 (Y_b + C_b J_w)
    tau   = c_m + H_bm^T a_b + H_m qdd                              J_tau = Y_m + H_bm^T J_a + C_m
    J_w f     = a_b + wd x r + w x (w x r)

with Y_h the base rows of Y(q, 0, nu) at the full predicted nu (v_b included) and C = dc/dw. RDA
(eqs. 22-23 of the paper) is the torque channel, CM (eq. 30) the gyro channel of the same model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrs

from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.impulse import (
    Impulse,
    external_force,
    momentum_at_nodes,
    needed,
    pulled,
)
from fsw.estimators.measurement.motion_noise import residual_covariance, smoothed
from fsw.estimators.measurement.mrnea import Rows, field, whitened
from fsw.estimators.measurement.prediction import CHANNELS, Prediction, Rate
from fsw.estimators.model.inertia import cross, skew
from fsw.estimators.model.problem import Problem, present
from fsw.messages import Block, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Dynamics:
    """Mass matrix, velocity derivative and regressors at the nodes' predicted base motion."""

    H: FloatArray  # (m, 6+n, 6+n)
    H_bb_inverse: FloatArray  # (m, 6, 6)
    C: FloatArray  # (m, 6+n, 6+n)
    Y: FloatArray  # (m, 6+n, k) at the predicted acceleration, unknown bodies' columns
    Y_h: FloatArray | None  # (m, 6, k) momentum regressor, where the rate is predicted by it
    nu: FloatArray  # (m, 6) predicted base velocity
    a: FloatArray  # (m, 6) predicted base acceleration
    force: FloatArray  # (m, n) joint torque
    by_angle: FloatArray | None  # (m, 6+n, n) d(generalised force)/dq, where angles are noisy
    h_by_angle: FloatArray | None  # (m, 6, n) d(base momentum)/dq


def _dynamics(
    s: BlockStack, x: FloatArray, problem: Problem, rate: Rate, L_B: FloatArray, G: FloatArray
) -> _Dynamics:
    """Evaluate the model at the nodes; L_B (N, 3) is the angular momentum, G the field.

    Raises
    ------
    numpy.linalg.LinAlgError if the base's inertia is not positive definite at these parameters.
    """
    model, n, N = problem.model, s.n, len(s.q_rad)
    pi = problem.pi(x)
    model.set_parameters(pi)
    q, qd = s.q_rad, s.qd_rad_s
    H = model.mass_matrices(q)
    np.linalg.cholesky(H[:, :6, :6])  # raises
    inverse = np.asarray(np.linalg.solve(H[:, :6, :6], np.eye(6)), np.float64)
    nu, a = np.zeros((2, N, 6 + n))
    nu[:, 6:], a[:, 6:] = qd, s.qdd_rad_s2
    momentum = -_times(H[:, :6, 6:], qd)
    momentum[:, 3:] += L_B
    nu[:, :6] = _times(inverse, momentum)
    Y_h = None
    if rate == "measured":
        nu[:, 3:6] = s.w_NB_B_rad_s
        if present(problem.gyro_bias):
            nu[:, 3:6] -= x[problem.gyro_bias]
    else:
        Y_h = model.momentum_regressors(q, nu)[:, :6] @ problem.U
    w = nu[:, 3:6]
    load = -model.generalised_forces(q, w, qd, a)[:, :6]
    Y_field = None
    if problem.orbit is not None:
        Y_field = np.stack([model.field_regressor(q[i], G[i]) for i in range(N)])
        load += Y_field[:, :6] @ pi
    outside = external_force(s, x, problem)[0] if pulled(problem) else None
    if outside is not None:
        load += outside[:, :6]
    a[:, :6] = _times(inverse, load)
    Y = model.regressors(q, w, qd, a)
    if Y_field is not None:
        Y -= Y_field
    C = model.bias_derivatives(q, w, qd, a)
    force = Y[:, 6:] @ pi
    by_angle = h_by_angle = None
    if s.angles_are_noisy:
        by_angle, h_by_angle = np.empty((N, 6 + n, n)), np.empty((N, 6, n))
        for i in range(N):
            by_angle[i] = model.angle_derivative(q[i], w[i], qd[i], a[i])
            h_by_angle[i] = model.momentum_derivative(q[i], nu[i])
    return _Dynamics(
        H,
        inverse,
        C,
        Y @ problem.U,
        Y_h,
        nu[:, :6],
        a[:, :6],
        force if outside is None else force - outside[:, 6:],
        by_angle,
        h_by_angle,
    )


def _times(A: FloatArray, v: FloatArray) -> FloatArray:
    """Return A v at every node, A (N, r, k), v (N, k)."""
    product: FloatArray = (A @ v[:, :, None])[:, :, 0]
    return product


def predict(
    block: Block | BlockStack,
    x: FloatArray,
    problem: Problem,
    rate: Rate = "momentum",
    before: Impulse | None = None,
) -> Prediction:
    """Predict every channel at the nodes of blocks from joint motion, with exact Jacobians.

    `rate` says where the base's angular velocity comes from: `momentum` predicts it (fused, CM),
    `measured` takes the gyro less its bias (RDA as the paper has it). `before` is the momentum
    gained from external moments up to the block.
    """
    s = block if isinstance(block, BlockStack) else BlockStack((block,))
    m, n = s.q_rad.shape
    p, k, r = len(x), problem.bodies, problem.p_BS_m
    G = field(s, problem)
    L_B, J_L, after = _momentum(s, x, problem, G, before)
    d = _dynamics(s, x, problem, rate, L_B, G)
    H_bm, C_w = d.H[:, :6, 6:], d.C[:, :, 3:6]
    J_w = np.zeros((m, 3, p))
    if d.Y_h is not None:
        gained = np.concatenate([np.zeros((m, 3, p)), J_L], axis=1)
        gained[:, :, k] -= d.Y_h
        J_w = d.H_bb_inverse[:, 3:] @ gained
    elif present(problem.gyro_bias):
        J_w[:, :, problem.gyro_bias] = -np.eye(3)
    reaction = C_w[:, :6] @ J_w
    reaction[:, :, k] += d.Y[:, :6]
    outside = external_force(s, x, problem)[1] if pulled(problem) else None
    if outside is not None:
        reaction -= outside[:, :6]
    J_a = -(d.H_bb_inverse @ reaction)
    tau, J_tau = d.force, H_bm.transpose(0, 2, 1) @ J_a + C_w[:, 6:] @ J_w
    J_tau[:, :, k] += d.Y[:, 6:]
    if outside is not None:
        J_tau -= outside[:, 6:]
    w, wd = d.nu[:, 3:], d.a[:, 3:]
    f = d.a[:, :3] + cross(wd, r) + cross(w, cross(w, r)) - G @ r
    centripetal = -skew(cross(w, r)) - skew(w) @ skew(r)
    J_f = J_a[:, :3] - skew(r) @ J_a[:, 3:] + centripetal @ J_w
    D_qdd, D_qd, D_w = _motion_gains(d, centripetal, r, rate)
    D_q = _angle_gain(d, D_w, r, rate)
    if present(problem.torque_scale):
        for gain in (D_qdd, D_qd, D_w) if D_q is None else (D_qdd, D_qd, D_w, D_q):
            gain[:, :n] *= 1.0 + x[problem.torque_scale][:, None]
    tau, J_tau = _torque_errors(tau, J_tau, x, problem)
    if present(problem.acc_bias):
        f = f + x[problem.acc_bias]
        J_f[:, :, problem.acc_bias] += np.eye(3)
    if present(problem.gyro_bias):
        w = w + x[problem.gyro_bias]
        J_w = J_w.copy()
        J_w[:, :, problem.gyro_bias] += np.eye(3)
    return Prediction(tau, f, w, J_tau, J_f, J_w, D_qdd, D_qd, D_w, D_q, after[-1], after)


def _momentum(
    s: BlockStack, x: FloatArray, problem: Problem, G: FloatArray, before: Impulse | None
) -> tuple[FloatArray, FloatArray, tuple[Impulse | None, ...]]:
    """Return the angular momentum in base axes (N, 3), its Jacobian (N, 3, p), and what follows."""
    N = len(s.q_rad)
    after: tuple[Impulse | None, ...] = (None,) * len(s.blocks)
    if not needed(problem) and not present(problem.momentum):
        return np.zeros((N, 3)), np.zeros((N, 3, len(x))), after
    L_N, J = np.zeros((N, 3)), np.zeros((N, 3, len(x)))
    if needed(problem):
        ends: list[Impulse | None] = []
        for i, block in enumerate(s.blocks):
            k = slice(i * s.m, (i + 1) * s.m)
            L_N[k], J[k], before = momentum_at_nodes(block, x, problem, G[k], before)
            ends.append(before)
        after = tuple(ends)
    if present(problem.momentum):
        L_N = L_N + x[problem.momentum]
        J[:, :, problem.momentum] += np.eye(3)
    R_BN = s.R_NB.transpose(0, 2, 1)
    return _times(R_BN, L_N), R_BN @ J, after


def _torque_errors(
    tau: FloatArray, J_tau: FloatArray, x: FloatArray, problem: Problem
) -> tuple[FloatArray, FloatArray]:
    """Apply the sensors' scale errors and offsets: (1 + s) tau + o."""
    n = tau.shape[1]
    if present(problem.torque_scale):
        gain = 1.0 + x[problem.torque_scale]
        J_tau = J_tau * gain[:, None]
        J_tau[:, :, problem.torque_scale] += tau[:, :, None] * np.eye(n)
        tau = tau * gain
    if present(problem.torque_offset):
        tau = tau + x[problem.torque_offset]
        J_tau[:, :, problem.torque_offset] += np.eye(n)
    return tau, J_tau


def fused_rows(
    block: Block,
    x: FloatArray,
    problem: Problem,
    channels: tuple[str, ...] = CHANNELS,
    rate: Rate = "momentum",
    before: Impulse | None = None,
) -> Rows:
    """Return `stacked_fused_rows` of one block."""
    return stacked_fused_rows(BlockStack((block,)), x, problem, channels, rate, before)[0]


def stacked_fused_rows(
    s: BlockStack,
    x: FloatArray,
    problem: Problem,
    channels: tuple[str, ...] = CHANNELS,
    rate: Rate = "momentum",
    before: Impulse | None = None,
) -> list[Rows]:
    """Return the whitened rows of every block for the chosen channels.

    The noise of the joints' own derivatives, and of a measured base rate, enters through the exact
    sensitivities, correlated over the nodes of a block and over the channels.
    """
    prediction = predict(s, x, problem, rate, before)
    use = np.concatenate(
        [
            s.has_joint & ("torque" in channels),
            np.full(3, "accelerometer" in channels and s.has_accelerometer),
            np.full(3, "gyro" in channels and s.has_gyro),
        ]
    )
    r = np.concatenate(
        [
            s.tau_nm - prediction.tau_nm,
            s.f_NS_B_m_s2 - prediction.f_m_s2,
            s.w_NB_B_rad_s - prediction.w_rad_s,
        ],
        axis=1,
    )[:, use]
    S = residual_covariance(s, prediction, use, rate)
    L = np.asarray(np.linalg.cholesky(S), np.float64)
    at, size = prediction, S.shape[1]
    residuals = r.reshape(len(s.blocks), size)
    if prediction.D_q is not None:
        weighted = [dpotrs(root, own, lower=1)[0] for root, own in zip(L, residuals, strict=True)]
        moved = smoothed(s, prediction, use, np.array(weighted).reshape(r.shape))
        at = predict(moved, x, problem, rate, before)
    X = np.concatenate([at.J_tau, at.J_f, at.J_w], axis=1)[:, use]
    X = X.reshape(len(s.blocks), size, len(x))
    found = []
    for root, columns, own, after in zip(L, X, residuals, prediction.each, strict=True):
        A, b = whitened(root, columns, own)
        found.append(Rows(A, b, after, root, use))
    return found


def _angle_gain(d: _Dynamics, D_w: FloatArray, r: FloatArray, rate: Rate) -> FloatArray | None:
    """Return d[tau; f; w]/dq (m, n + 6, n) without external wrench; None where angles are exact."""
    if d.by_angle is None or d.h_by_angle is None:
        return None
    n, H_bm = d.by_angle.shape[2], d.H[:, :6, 6:]
    reaction = -d.H_bb_inverse @ np.concatenate([d.by_angle[:, :6], d.h_by_angle], axis=2)
    a_q, w_q = reaction[:, :, :n], reaction[:, 3:, n:]
    if rate == "measured":
        w_q = np.zeros_like(w_q)
    lever = np.concatenate([np.eye(3), -skew(r)], axis=1)
    tau_q = d.by_angle[:, 6:] + H_bm.transpose(0, 2, 1) @ a_q
    direct = np.concatenate([tau_q, lever @ a_q], axis=1)
    return np.concatenate([direct + D_w @ w_q, w_q], axis=1)


def _motion_gains(
    d: _Dynamics, centripetal: FloatArray, r: FloatArray, rate: Rate
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return d[tau; f]/d qdd, d[tau; f; w]/d qd and d[tau; f]/dw at zero external wrench."""
    C, H_bm, H_m = d.C, d.H[:, :6, 6:], d.H[:, 6:, 6:]
    lever = np.concatenate([np.eye(3), -skew(r)], axis=1)
    n = H_m.shape[1]
    reaction = -d.H_bb_inverse @ np.concatenate([H_bm, C[:, :6, 3:]], axis=2)
    N, a_w, a_qd = reaction[:, :, :n], reaction[:, :, n : n + 3], reaction[:, :, n + 3 :]
    D_qdd = np.concatenate([H_m + H_bm.transpose(0, 2, 1) @ N, lever @ N], axis=1)
    D_w = np.concatenate(
        [C[:, 6:, 3:6] + H_bm.transpose(0, 2, 1) @ a_w, lever @ a_w + centripetal], axis=1
    )
    D_qd = np.concatenate([C[:, 6:, 6:] + H_bm.transpose(0, 2, 1) @ a_qd, lever @ a_qd], axis=1)
    w_qd = N[:, 3:] if rate == "momentum" else np.zeros_like(N[:, 3:])
    return D_qdd, np.concatenate([D_qd + D_w @ w_qd, w_qd], axis=1), D_w
