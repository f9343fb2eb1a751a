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

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtrs

from fsw.estimators.measurement.impulse import (
    Impulse,
    external_force,
    momentum_at_nodes,
    needed,
    pulled,
)
from fsw.estimators.measurement.mrnea import Rows, field
from fsw.estimators.model.inertia import cross, skew
from fsw.estimators.model.problem import Problem, present
from fsw.messages import Block, FloatArray

CHANNELS = ("torque", "accelerometer", "gyro")
Rate = Literal["momentum", "measured"]


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Predicted channels at m nodes and their Jacobians with respect to the state (p)."""

    tau_nm: FloatArray  # (m, n)
    f_m_s2: FloatArray  # (m, 3)
    w_rad_s: FloatArray  # (m, 3)
    J_tau: FloatArray  # (m, n, p)
    J_f: FloatArray  # (m, 3, p)
    J_w: FloatArray  # (m, 3, p)
    D_qdd: FloatArray  # (m, n + 3, n): d[tau; f]/d qdd
    D_qd: FloatArray  # (m, n + 6, n): d[tau; f; w]/d qd
    D_w: FloatArray  # (m, n + 3, 3): d[tau; f]/dw
    D_q: FloatArray | None  # (m, n + 6, n): d[tau; f; w]/dq where angles are noisy
    after: Impulse | None  # momentum gained up to the block's end


@dataclass(frozen=True, slots=True, eq=False)
class _Dynamics:
    """Mass matrix, velocity derivative and regressors at the nodes' predicted base motion."""

    H: FloatArray  # (m, 6+n, 6+n)
    H_bb_inverse: FloatArray  # (m, 6, 6)
    C: FloatArray  # (m, 6+n, 6+n)
    Y: FloatArray  # (m, 6+n, k) at the predicted acceleration, unknown bodies' columns
    Y_h: FloatArray  # (m, 6, k) momentum regressor
    nu: FloatArray  # (m, 6) predicted base velocity
    a: FloatArray  # (m, 6) predicted base acceleration
    force: FloatArray  # (m, n) joint torque
    by_angle: FloatArray | None  # (m, 6+n, n) d(generalised force)/dq, where angles are noisy
    h_by_angle: FloatArray | None  # (m, 6, n) d(base momentum)/dq


def _dynamics(
    block: Block, x: FloatArray, problem: Problem, rate: Rate, L_B: FloatArray, G: FloatArray
) -> _Dynamics:
    """Evaluate the model at the nodes; L_B (m, 3) is the angular momentum, G the field.

    Raises
    ------
    numpy.linalg.LinAlgError if the base's inertia is not positive definite at these parameters.
    """
    model, n, m = problem.model, problem.model.n, len(block.t_ns)
    pi = problem.pi(x)
    model.set_parameters(pi)
    H, C = np.empty((2, m, 6 + n, 6 + n))
    Y, Y_h = np.empty((2, m, 6 + n, pi.size))
    nu, a = np.zeros((2, m, 6 + n))
    nu[:, 6:], a[:, 6:] = block.qd_rad_s, block.qdd_rad_s2
    momentum = np.concatenate([np.zeros((m, 3)), L_B], axis=1)
    noisy = angles_are_noisy(block)
    by_angle = np.empty((m, 6 + n, n)) if noisy else None
    h_by_angle = np.empty((m, 6, n)) if noisy else None
    force = external_force(block, x, problem)[0] if pulled(problem) else np.zeros((m, 6 + n))
    w_measured = block.w_NB_B_rad_s
    if present(problem.gyro_bias):
        w_measured = w_measured - x[problem.gyro_bias]
    for i in range(m):
        q, qd = block.q_rad[i], block.qd_rad_s[i]
        H[i] = model.mass_matrix(q)
        L, info = dpotrf(H[i, :6, :6], lower=1)
        if info != 0:
            raise np.linalg.LinAlgError("base inertia is not positive definite")
        nu[i, :6] = dpotrs(L, momentum[i] - H[i, :6, 6:] @ qd, lower=1)[0]
        if rate == "measured":
            nu[i, 3:6] = w_measured[i]
        Y_h[i] = model.momentum_regressor(q, nu[i])
        w = nu[i, 3:6]
        bias = model.generalised_force(q, w, qd, a[i])[:6]
        Y_field = model.field_regressor(q, G[i]) if problem.orbit is not None else None
        if Y_field is not None:
            bias = bias - Y_field[:6] @ pi
        a[i, :6] = dpotrs(L, force[i, :6] - bias, lower=1)[0]
        Y[i] = model.regressor(q, w, qd, a[i])
        if Y_field is not None:
            Y[i] -= Y_field
        C[i] = model.bias_derivative(q, w, qd, a[i])
        if by_angle is not None and h_by_angle is not None:
            by_angle[i] = model.angle_derivative(q, w, qd, a[i])
            h_by_angle[i] = model.momentum_derivative(q, nu[i])
    return _Dynamics(
        H,
        np.linalg.solve(H[:, :6, :6], np.eye(6)),
        C,
        Y @ problem.U,
        Y_h[:, :6] @ problem.U,
        nu[:, :6],
        a[:, :6],
        Y[:, 6:] @ pi - force[:, 6:],
        by_angle,
        h_by_angle,
    )


def predict(
    block: Block,
    x: FloatArray,
    problem: Problem,
    rate: Rate = "momentum",
    before: Impulse | None = None,
) -> Prediction:
    """Predict every channel at the nodes of a block from joint motion, with exact Jacobians.

    `rate` says where the base's angular velocity comes from: `momentum` predicts it (fused, CM),
    `measured` takes the gyro less its bias (RDA as the paper has it). `before` is the momentum
    gained from external moments up to the block.
    """
    m, n = block.q_rad.shape
    p, k, r = len(x), problem.bodies, problem.p_BS_m
    G = field(block, problem)
    L_B, J_L, after = _momentum(block, x, problem, G, before)
    d = _dynamics(block, x, problem, rate, L_B, G)
    H_bm, C_w = d.H[:, :6, 6:], d.C[:, :, 3:6]
    J_w = np.zeros((m, 3, p))
    if rate == "momentum":
        gained = np.concatenate([np.zeros((m, 3, p)), J_L], axis=1)
        gained[:, :, k] -= d.Y_h
        J_w = d.H_bb_inverse[:, 3:] @ gained
    elif present(problem.gyro_bias):
        J_w[:, :, problem.gyro_bias] = -np.eye(3)
    reaction = C_w[:, :6] @ J_w
    reaction[:, :, k] += d.Y[:, :6]
    outside = external_force(block, x, problem)[1] if pulled(problem) else None
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
    return Prediction(tau, f, w, J_tau, J_f, J_w, D_qdd, D_qd, D_w, D_q, after)


def _momentum(
    block: Block, x: FloatArray, problem: Problem, G: FloatArray, before: Impulse | None
) -> tuple[FloatArray, FloatArray, Impulse | None]:
    """Return the angular momentum in base axes (m, 3), its Jacobian (m, 3, p), and what follows."""
    m = len(block.t_ns)
    L_N, J, after = np.zeros((m, 3)), np.zeros((m, 3, len(x))), None
    if needed(problem):
        L_N, J, after = momentum_at_nodes(block, x, problem, G, before)
    if present(problem.momentum):
        L_N = L_N + x[problem.momentum]
        J[:, :, problem.momentum] += np.eye(3)
    R_BN = block.R_NB.transpose(0, 2, 1)
    return np.einsum("mij,mj->mi", R_BN, L_N), R_BN @ J, after


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
    """Return the whitened rows of one block for the chosen channels.

    The noise of the joints' own derivatives, and of a measured base rate, enters through the exact
    sensitivities, correlated over the nodes of the block and over the channels.
    """
    prediction = predict(block, x, problem, rate, before)
    use = np.concatenate(
        [
            block.has_joint & ("torque" in channels),
            np.full(3, "accelerometer" in channels and block.has_accelerometer),
            np.full(3, "gyro" in channels and block.has_gyro),
        ]
    )
    r = np.concatenate(
        [
            block.tau_nm - prediction.tau_nm,
            block.f_NS_B_m_s2 - prediction.f_m_s2,
            block.w_NB_B_rad_s - prediction.w_rad_s,
        ],
        axis=1,
    )[:, use]
    size, p = r.size, len(x)
    L = np.asarray(np.linalg.cholesky(_covariance(block, prediction, use, rate)), np.float64)
    at = prediction
    if prediction.D_q is not None:
        weighted = np.asarray(dpotrs(L, r.ravel(), lower=1)[0]).reshape(r.shape)
        at = predict(_smoothed(block, prediction, use, weighted), x, problem, rate, before)
    X = np.concatenate([at.J_tau, at.J_f, at.J_w], axis=1)[:, use]
    stacked = np.empty((size, p + 1), order="F")
    stacked[:, :p], stacked[:, p] = X.reshape(size, p), r.ravel()
    white = dtrtrs(L, stacked, lower=1, overwrite_b=1)[0]
    return Rows(white[:, :p], white[:, p], prediction.after, L, use)


def _covariance(
    block: Block, prediction: Prediction, use: NDArray[np.bool_], rate: Rate
) -> FloatArray:
    """Return the covariance of the stacked residuals (node-major) of the channels in use."""
    m, n = block.q_rad.shape
    S = np.zeros((m, n + 6, m, n + 6))
    for j in range(n):
        S[:, j, :, j] = block.cov_tau[j]
    for axis in range(3):
        S[:, n + axis, :, n + axis] = block.cov_acc
        S[:, n + 3 + axis, :, n + 3 + axis] = block.cov_gyro[:m, :m]
    size = m * int(use.sum())
    S = S[:, use][:, :, :, use].reshape(size, size)
    D = _by_motion(prediction)[:, :, use]
    orders = len(D)
    S += _through(D, block.cov_joint.reshape(n, orders, m, orders, m)).reshape(size, size)
    if rate == "measured":
        D_w = np.zeros((1, m, n + 6, 3))
        D_w[0, :, : n + 3] = prediction.D_w
        gyro = np.broadcast_to(block.cov_gyro[:m, :m], (3, m, m)).reshape(3, 1, m, 1, m)
        S += _through(D_w[:, :, use], gyro).reshape(size, size)
    return S


def angles_are_noisy(block: Block) -> bool:
    """Return whether the block gives the covariance of the angles beside those of the rates."""
    return bool(block.cov_joint.shape[1] == 3 * len(block.t_ns))


def _by_motion(prediction: Prediction) -> FloatArray:
    """Return (2 or 3, m, n + 6, n): by qd, by qdd, and by q where angles are noisy."""
    m, rows, n = prediction.D_qd.shape
    D = np.zeros((2 if prediction.D_q is None else 3, m, rows, n))
    D[0], D[1, :, : n + 3] = prediction.D_qd, prediction.D_qdd
    if prediction.D_q is not None:
        D[2] = prediction.D_q
    return D


def _smoothed(
    block: Block, prediction: Prediction, use: NDArray[np.bool_], weighted: FloatArray
) -> Block:
    """Return the block with the joint motion that residuals S^-1 r (m, rows) make more likely.

    At the measured motion the Jacobian is correlated with the residuals by the motion's noise,
    which shrinks the estimate; at z + Sigma D^T S^-1 r it is not. Source: as mrnea.py.
    """
    m, n = block.q_rad.shape
    D = _by_motion(prediction)[:, :, use]
    pulled = np.einsum("dmrj,mr->jdm", D, weighted).reshape(n, -1, 1)
    step = (block.cov_joint @ pulled).reshape(n, 3, m).transpose(1, 2, 0)
    return replace(
        block,
        qd_rad_s=block.qd_rad_s + step[0],
        qdd_rad_s2=block.qdd_rad_s2 + step[1],
        q_rad=block.q_rad + step[2],
    )


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


def _through(D: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return (m, r, m, r): what errors of this covariance (j, d, m, d, m) make of the residuals.

    `D` (d, m, r, j) are sensitivities to the d-th derivatives of channel j at the same node.
    """
    d, m, r, j = D.shape
    left = D.transpose(1, 2, 0, 3).reshape(m, r, d * j)
    mixed = np.einsum("jdiek,ekrj->idjkr", covariance, D, optimize=False)
    through: FloatArray = left @ mixed.reshape(m, d * j, m * r)
    return through.reshape(m, r, m, r)


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
