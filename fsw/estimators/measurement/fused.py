"""The fused measurement model: torque, accelerometer and gyro predicted from joint motion alone.

At zero (or known, or estimated) momentum the base's whole motion follows from the arm's, so the
prediction needs no base measurement and no v_b; gyro and accelerometer are pure measurements. Every
Jacobian is exact and comes from two regressors and one 6 x 6 factorisation per node:

    w     = [-H_bb^-1 H_bm qd + H_bb^-1 [0; L_B]]_3:6               J_nu = -H_bb^-1 Y_h
    a_b   = -H_bb^-1 (c_b + H_bm qdd)                               J_a  = -H_bb^-1 (Y_b + C_b J_w)
    tau   = c_m + H_bm^T a_b + H_m qdd                              J_tau = Y_m + H_bm^T J_a + C_m
    J_w f     = a_b + wd x r + w x (w x r)

A base that is held in part (`base.motion`) gives way along its free motions S alone, with
S (S^T H_bb S)^-1 S^T for H_bb^-1, and carries the support's acceleration, minus gravity.

with Y_h the base rows of Y(q, 0, nu) at the full predicted nu (v_b included) and C = dc/dw. RDA
(eqs. 22-23 of the paper) is the torque channel, CM (eq. 30) the gyro channel of the same model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrs

from fsw.estimators.measurement import friction
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.impulse import (
    Impulse,
    external_force,
    momentum_at_nodes,
    needed,
    pulled,
)
from fsw.estimators.measurement.modes import Channels, released
from fsw.estimators.measurement.motion_noise import residual_covariance, smoothed
from fsw.estimators.measurement.mounting import as_true, turn
from fsw.estimators.measurement.mrnea import Rows, field, whitened
from fsw.estimators.measurement.prediction import CHANNELS, Prediction, Rate
from fsw.estimators.measurement.wheels import Wheels, turning
from fsw.estimators.model.inertia import skew
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
    wheels: Wheels | None
    by_angle: FloatArray | None  # (m, 6+n, n) d(generalised force)/dq, where angles are noisy
    h_by_angle: FloatArray | None  # (m, 6, n) d(base momentum)/dq


def _dynamics(
    s: BlockStack,
    x: FloatArray,
    problem: Problem,
    rate: Rate,
    given: tuple[FloatArray, FloatArray, Wheels | None],
) -> _Dynamics:
    """Evaluate the model at the nodes.

    `given`: the angular momentum (N, 3) that base and arm have, the field, and the wheels.

    Raises
    ------
    numpy.linalg.LinAlgError if the base's inertia is not positive definite at these parameters.
    """
    model, n, N = problem.model, s.n, len(s.q_rad)
    L_B, G, wheels = given
    pi = problem.pi(x)
    model.set_parameters(pi)
    q, qd = s.q_rad, s.qd_rad_s
    H = model.mass_matrices(q)
    inverse = _yielding(H[:, :6, :6], problem)
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
        if present(problem.imu_angle):
            nu[:, 3:6] = nu[:, 3:6] @ turn(x, problem)[0].T
    else:
        Y_h = model.momentum_regressors(q, nu)[:, :6] @ problem.U
    w = nu[:, 3:6]
    C, force = model.forces_and_derivatives(q, w, qd, a)  # of a base that does not accelerate
    Y_field = None
    if problem.orbit is not None:
        Y_field = np.stack([model.field_regressor(q[i], G[i]) for i in range(N)])
        force -= Y_field @ pi
    if pulled(problem):
        force -= external_force(s, x, problem)[0]
    if wheels is not None:
        force[:, 3:6] += wheels.moment(w)
        C[:, 3:6, 3:6] += wheels.by_rate()
    a[:, :6] = -_times(inverse, force[:, :6])
    if problem.support_m_s2.any():
        held = np.concatenate([problem.support_m_s2, np.zeros(3)])
        a[:, :6] += held - _times(inverse, H[:, :6, :6] @ held)
    Y = model.regressors(q, w, qd, a)
    if Y_field is not None:
        Y -= Y_field
    by_angle = h_by_angle = None
    if s.angles_are_noisy or present(problem.joint_zero) or present(problem.mode_start):
        by_angle, h_by_angle = np.empty((N, 6 + n, n)), np.empty((N, 6, n))
        for i in range(N):
            by_angle[i] = model.angle_derivative(q[i], w[i], qd[i], a[i])
            h_by_angle[i] = model.momentum_derivative(q[i], nu[i])
    return _Dynamics(
        H=H,
        H_bb_inverse=inverse,
        C=C,
        Y=Y @ problem.U,
        Y_h=Y_h,
        nu=nu[:, :6],
        a=a[:, :6],
        force=force[:, 6:] + _times(H[:, 6:, :6], a[:, :6]),
        wheels=wheels,
        by_angle=by_angle,
        h_by_angle=h_by_angle,
    )


def _yielding(H_bb: FloatArray, problem: Problem) -> FloatArray:
    """Return (N, 6, 6): the base's acceleration by a force; the inverse of H_bb if it is free.

    With the free motions S, S (S^T H_bb S)^-1 S^T: what holds the base bears the rest.

    Raises
    ------
    numpy.linalg.LinAlgError if the inertia of a free motion is not positive.
    """
    S = problem.freedom
    own = H_bb if problem.is_free else S.T @ H_bb @ S
    np.linalg.cholesky(own)  # raises
    inverse = np.asarray(np.linalg.solve(own, np.eye(S.shape[1])), np.float64)
    return inverse if problem.is_free else np.asarray(S @ inverse @ S.T, np.float64)


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
    s = as_true(block if isinstance(block, BlockStack) else BlockStack((block,)), x, problem)
    n = s.n
    if problem.modes is None:
        at = _ideal(s, x, problem, rate, before)
    else:
        at = released(s, x, problem, rate, before, _ideal)
    D, D_q, D_wheel, D_start = at.D, at.D_q, at.D_wheel, at.D_start
    tau, f, w = at.tau, at.f, at.w
    D_w, J = D[:, : n + 3, n : n + 3], D[:, :, 2 * n + 3 :]
    single = [gains for gains in (D, D_q, D_start) if gains is not None]
    every = [*single, *(() if D_wheel is None else D_wheel)]
    if present(problem.imu_angle):
        f, w = _as_turned((f, w), D, every, x, problem, rate)
    lost, by_rate = friction.torque(s, x, problem)
    tau = tau + lost
    D[:, :n, n + 3 : 2 * n + 3] += by_rate[:, :, None] * np.eye(n)
    friction.fill_columns(J[:, :n], s, problem)
    if present(problem.torque_scale):
        gain = 1.0 + x[problem.torque_scale]
        for gains in every:
            gains[:, :n] *= gain[:, None]
        J[:, :n, problem.torque_scale] += tau[:, :, None] * np.eye(n)
        tau = tau * gain
    if present(problem.joint_zero) and D_q is not None:
        J[:, :, problem.joint_zero] += D_q
    if present(problem.torque_offset):
        tau = tau + x[problem.torque_offset]
        J[:, :n, problem.torque_offset] += np.eye(n)
    if present(problem.acc_bias):
        f = f + x[problem.acc_bias]
        J[:, n : n + 3, problem.acc_bias] += np.eye(3)
    if present(problem.gyro_bias):
        w = w + x[problem.gyro_bias]
        J[:, n + 3 :, problem.gyro_bias] += np.eye(3)
    return Prediction(
        tau_nm=tau,
        f_m_s2=f,
        w_rad_s=w,
        J=J,
        J_tau=J[:, :n],
        J_f=J[:, n : n + 3],
        J_w=J[:, n + 3 :],
        D_qdd=D[:, : n + 3, :n],
        D_qd=D[:, :, n + 3 : 2 * n + 3],
        D_w=D_w,
        D_q=D_q if s.angles_are_noisy else None,
        D_wheel=D_wheel,
        after=at.each[-1],
        each=at.each,
        D_start=D_start,
        doubt=at.doubt,
    )


def _ideal(
    s: BlockStack, x: FloatArray, problem: Problem, rate: Rate, before: Impulse | None
) -> Channels:
    """Return what sensors without errors of their own measure where joints move as told."""
    n, r = s.n, problem.place_m(x)
    G = field(s, problem)
    L_B, J_L, after = _momentum(s, x, problem, G, before)
    wheels = turning(s, x, problem)
    if wheels is not None:  # base and arm have what the wheels do not
        L_B = L_B - wheels.h_nms
        J_L = -wheels.J_h if J_L is None else J_L - wheels.J_h
    d = _dynamics(s, x, problem, rate, (L_B, G, wheels))
    w, lever = d.nu[:, 3:], np.concatenate([np.eye(3), -skew(r)], axis=1)
    f = d.a @ lever.T + w * (w @ r)[:, None] - np.sum(w * w, axis=1)[:, None] * r - G @ r
    D = _gains(s, x, problem, d, J_L, r)
    D_w = D[:, : n + 3, n : n + 3]
    if present(problem.imu_place):
        D[:, n : n + 3, 2 * n + 3 :][:, :, problem.imu_place] += _by_place(d.a[:, 3:], w) - G
    D_q, D_wheel = _angle_gain(d, D_w, r, rate), _wheel_gain(d, D_w, r, rate)
    return Channels(d.force, f, w, D, D_q, D_wheel, after)


def _gains(
    s: BlockStack,
    x: FloatArray,
    problem: Problem,
    d: _Dynamics,
    J_L: FloatArray | None,
    r: FloatArray,
) -> FloatArray:
    """Return d[tau; f; w]/d[qdd, w, qd, x] (N, n + 6, 2 n + 3 + p), less the sensors' own errors.

    The base rows of the direct effect on the generalised force give the base's acceleration, that
    acts on torque and force; what acts on the rate acts through it on both.
    """
    n, w, lever = s.n, d.nu[:, 3:], np.concatenate([np.eye(3), -skew(r)], axis=1)
    direct = np.zeros((len(w), 6 + n, 2 * n + 3 + len(x)))
    direct[:, :, :n], direct[:, :, n : 2 * n + 3] = d.H[:, :, 6:], d.C[:, :, 3:]
    by_state = direct[:, :, 2 * n + 3 :]
    by_state[:, :, problem.inertial] = d.Y
    if pulled(problem):
        by_state -= external_force(s, x, problem)[1]
    if d.wheels is not None:
        by_state[:, 3:6] += d.wheels.by_state(w)
    base = -(d.H_bb_inverse @ direct[:, :6])
    D = np.empty((len(w), n + 6, direct.shape[2]))
    D[:, :n] = direct[:, 6:] + d.H[:, 6:, :6] @ base
    D[:, n : n + 3] = lever @ base
    D_w = D[:, : n + 3, n : n + 3]  # w x (w x r) = w (w.r) - r (w.w)
    D_w[:, n:] += (w @ r)[:, None, None] * np.eye(3) + w[:, :, None] * r
    D_w[:, n:] -= 2.0 * r[:, None] * w[:, None, :]
    D[:, n + 3 :] = 0.0
    rate = D[:, n + 3 :, n + 3 :]  # by qd and x
    if d.Y_h is not None:
        rate[:, :, :n] = base[:, 3:, :n]
        rate[:, :, n:][:, :, problem.inertial] = -(d.H_bb_inverse[:, 3:] @ d.Y_h)
        if J_L is not None:
            rate[:, :, n:] += d.H_bb_inverse[:, 3:, 3:] @ J_L
    else:
        R, by_angle = turn(x, problem)
        if present(problem.gyro_bias):
            rate[:, :, n:][:, :, problem.gyro_bias] = -R
        if present(problem.imu_angle):
            rate[:, :, n:][:, :, problem.imu_angle] = -skew(w) @ by_angle
    D[:, : n + 3, n + 3 :] += D_w @ rate
    return D


def _by_place(wd: FloatArray, w: FloatArray) -> FloatArray:
    """Return d(wd x r + w x (w x r))/dr (N, 3, 3)."""
    turned: FloatArray = skew(wd) + skew(w) @ skew(w)
    return turned


def _as_turned(
    channels: tuple[FloatArray, FloatArray],
    D: FloatArray,
    every: list[FloatArray],
    x: FloatArray,
    problem: Problem,
    rate: Rate,
) -> tuple[FloatArray, FloatArray]:
    """Return force and rate (N, 3) in the axes as configured; turn every gain in place too."""
    n = problem.model.n
    R, by_angle = turn(x, problem)
    f, w = (channel @ R for channel in channels)
    places = [slice(n, n + 3)] if rate == "measured" else [slice(n, n + 3), slice(n + 3, n + 6)]
    J = D[:, :, D.shape[2] - len(x) :]
    for k, own in zip(places, (f, w), strict=False):
        for gains in every:
            gains[:, k] = R.T @ gains[:, k]
        J[:, k, problem.imu_angle] += skew(own) @ (R.T @ by_angle)
    return f, w


def _momentum(
    s: BlockStack, x: FloatArray, problem: Problem, G: FloatArray, before: Impulse | None
) -> tuple[FloatArray, FloatArray | None, tuple[Impulse | None, ...]]:
    """Return the angular momentum in base axes (N, 3), its Jacobian (N, 3, p), and what follows.

    The Jacobian is None where the momentum is zero.
    """
    N = len(s.q_rad)
    after: tuple[Impulse | None, ...] = (None,) * len(s.blocks)
    if not needed(problem) and not present(problem.momentum):
        return np.zeros((N, 3)), None, after
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
    )
    r = r if use.all() else r[:, use]
    S = residual_covariance(s, prediction, use, rate)
    L = np.asarray(np.linalg.cholesky(S), np.float64)
    at, size = prediction, S.shape[1]
    residuals = r.reshape(len(s.blocks), size)
    if prediction.D_q is not None:
        weighted = [dpotrs(root, own, lower=1)[0] for root, own in zip(L, residuals, strict=True)]
        moved = smoothed(s, prediction, use, np.array(weighted).reshape(r.shape))
        at = predict(moved, x, problem, rate, before)
    X = (at.J if use.all() else at.J[:, use]).reshape(len(s.blocks), size, len(x))
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


def _wheel_gain(d: _Dynamics, D_w: FloatArray, r: FloatArray, rate: Rate) -> FloatArray | None:
    """Return d[tau; f; w]/d[h, d/dt h] (2, m, n + 6, k) of the wheels; None without."""
    if d.wheels is None:
        return None
    lever, H_bm = np.concatenate([np.eye(3), -skew(r)], axis=1), d.H[:, :6, 6:]
    n, w = H_bm.shape[2], d.nu[:, 3:]
    base = -(d.H_bb_inverse[:, :, 3:] @ d.wheels.by_motion(w))
    D = np.zeros((*base.shape[:2], n + 6, base.shape[3]))
    D[:, :, :n], D[:, :, n : n + 3] = H_bm.transpose(0, 2, 1) @ base, lever @ base
    if rate == "momentum":
        D[0, :, n + 3 :] = -(d.H_bb_inverse[:, 3:, 3:] @ d.wheels.axes)
        D[0, :, : n + 3] += D_w @ D[0, :, n + 3 :]
    return D
