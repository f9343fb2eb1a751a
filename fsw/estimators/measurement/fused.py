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

A base that is held in part (`base.motion`) moves along its free motions S alone: H_bb^-1 becomes
S (S^T H_bb S)^-1 S^T, and the base has the support's acceleration, minus gravity, in addition.
"""

from dataclasses import replace

import numpy as np

from fsw.estimators.effects.joint_torque import added, fill_columns
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.continuity import Joined
from fsw.estimators.measurement.dynamics import dynamics, times
from fsw.estimators.measurement.gains import angle_gain, by_place, carried_gain, state_gains
from fsw.estimators.measurement.impulse import (
    Impulse,
    momentum_at_nodes,
    needed,
)
from fsw.estimators.measurement.modes import Channels, released
from fsw.estimators.measurement.motion_noise import by_motion, residual_covariance
from fsw.estimators.measurement.mounting import (
    as_true,
    fill_angle_columns,
    fill_gyro_columns,
    gyro_turn,
    turn,
    with_bridges,
)
from fsw.estimators.measurement.mrnea import Rows, field
from fsw.estimators.measurement.prediction import CHANNELS, Prediction, Rate
from fsw.estimators.model.inertia import skew
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray


def predict(
    block: Block | BlockStack,
    x: FloatArray,
    problem: Problem,
    rate: Rate = "momentum",
    before: Impulse | None = None,
) -> Prediction:
    """Predict every channel at the nodes of blocks from joint motion, with exact Jacobians.

    `rate` says where the base's angular velocity comes from: `momentum` predicts it (fused, CM),
    `measured` uses the gyro minus its bias (RDA as in the paper). `before` is the momentum gained
    from external moments up to the block.
    """
    s = as_true(block if isinstance(block, BlockStack) else BlockStack((block,)), x, problem)
    if rate == "measured" and problem.delays:
        s = s.turning(problem.delays.prompt(x, s.w_NB_B_rad_s, s.m))
    n, t = s.n, s.t
    if problem.modes is None:
        at = _ideal(s, x, problem, rate, before)
    else:
        at = released(s, x, problem, rate, before, _ideal)
    D, D_q, D_carried, D_start = at.D, at.D_q, at.D_carried, at.D_start
    tau, f, w = at.tau, at.f, at.w
    D_w, J = D[:, : t + 3, n : n + 3], D[:, :, 2 * n + 3 :]
    single = [gains for gains in (D, D_q, D_start) if gains is not None]
    every = [*single, *(() if D_carried is None else D_carried)]
    if any(problem.has(group) for group in ("imu_angle", "gyro_scale", "gyro_axes")):
        f, w = _as_read((f, w), D, every, x, problem, rate)
    if problem.torque_terms:
        # a copy: tau becomes the reading
        motion = replace(s.joint_motion, load_nm=s.by_block(tau[:, :n].copy()))
        more, each = added(problem.torque_terms, motion, x), np.arange(n)
        tau[:, :n] += more.torque_nm
        for gains in every if np.any(more.by_load) else ():
            gains[:, :n] *= 1.0 + more.by_load[:, :, None]
        D[:, each, each] += more.by_acceleration
        D[:, each, n + 3 + each] += more.by_rate
        if D_q is not None:
            D_q[:, each, each] += more.by_angle
        fill_columns(J[:, :n], problem.torque_terms, motion)
    for states, rows in problem.sensed("torque_scale", "wrench_scale"):
        gain = 1.0 + x[states]
        for gains in every:
            gains[:, rows] *= gain[:, None]
        J[:, rows, states] += tau[:, rows, None] * np.eye(len(gain))
        tau[:, rows] *= gain
    if D_q is not None:
        by_motion = D_q, D[:, :, n + 3 : 2 * n + 3], D[:, :, :n]
        fill_angle_columns(J, by_motion, s, x, problem)
    for states, rows in problem.sensed("torque_offset", "wrench_offset"):
        tau[:, rows] += x[states]
        J[:, rows, states] += np.eye(states.stop - states.start)
    tau, f, w = _at_stamps((tau, f, w), J, s.m, x, problem, rate)
    return Prediction(
        tau_nm=tau,
        f_m_s2=f,
        w_rad_s=w,
        J=J,
        J_tau=J[:, :t],
        J_f=J[:, t : t + 3],
        J_w=J[:, t + 3 :],
        D_qdd=D[:, : t + 3, :n],
        D_qd=D[:, :, n + 3 : 2 * n + 3],
        D_w=D_w,
        D_q=D_q if problem.angles_are_noisy and s.has_angles else None,
        D_carried=D_carried,
        after=at.each[-1],
        each=at.each,
        D_start=D_start,
        doubt=at.doubt,
    )


def _ideal(
    s: BlockStack, x: FloatArray, problem: Problem, rate: Rate, before: Impulse | None
) -> Channels:
    """Return the readings of sensors without errors of their own, for the given joint motion."""
    n, r = s.n, problem.place_m(x)
    G = field(s, problem)
    L_B, J_L, after = _momentum(s, x, problem, G, before)
    carried = problem.carrier(s, x)
    if carried is not None:  # base and arm have the momentum minus what is carried
        L_B = L_B - carried.h_nms
        J_L = -carried.J_h if J_L is None else J_L - carried.J_h
    d = dynamics(s, x, problem, rate, (L_B, G, carried))
    w, lever = d.nu[:, 3:], np.concatenate([np.eye(3), -skew(r)], axis=1)
    f = d.a @ lever.T + w * (w @ r)[:, None] - np.sum(w * w, axis=1)[:, None] * r - G @ r
    D = state_gains(s, x, problem, d, J_L, r)
    t = d.force.shape[1]
    D_w = D[:, : t + 3, n : n + 3]
    if problem.has("imu_place"):
        D[:, t : t + 3, 2 * n + 3 :][:, :, problem.at("imu_place")] += by_place(d.a[:, 3:], w) - G
    D_q, D_carried = angle_gain(d, D_w, r, rate), carried_gain(d, D_w, r, rate)
    return Channels(d.force, f, w, D, D_q, D_carried, after)


def _as_read(
    channels: tuple[FloatArray, FloatArray],
    D: FloatArray,
    every: list[FloatArray],
    x: FloatArray,
    problem: Problem,
    rate: Rate,
) -> tuple[FloatArray, FloatArray]:
    """Return force and rate (N, 3) as the inertial unit reads them; convert all gains in place."""
    t = D.shape[1] - 6
    R, by_angle = turn(x, problem)
    to_read = R.T, np.linalg.solve(gyro_turn(x, problem), np.eye(3))
    J = D[:, :, D.shape[2] - len(x) :]
    places = [slice(t, t + 3), slice(t + 3, t + 6)][: 1 if rate == "measured" else 2]
    for k, M, true in zip(places, to_read, channels, strict=False):
        for gains in every:
            gains[:, k] = M @ gains[:, k]
        if problem.has("imu_angle"):
            J[:, k, problem.at("imu_angle")] += M @ skew(true) @ by_angle
    if rate != "measured":
        w, by_rate = channels[1], np.broadcast_to(-to_read[1], (len(D), 3, 3))
        fill_gyro_columns(J[:, t + 3 :], by_rate, w, x, problem)
    f, w = (true @ M.T for true, M in zip(channels, to_read, strict=True))
    return f, w


def _at_stamps(
    channels: tuple[FloatArray, FloatArray, FloatArray],
    J: FloatArray,
    nodes: int,
    x: FloatArray,
    problem: Problem,
    rate: Rate,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return torque, force and rate with biases and delays; change J (N, t + 6, p) in place."""
    (tau, f, w), t = channels, J.shape[1] - 6
    if problem.has("acc_bias"):
        f = f + x[problem.at("acc_bias")]
        J[:, t : t + 3, problem.at("acc_bias")] += np.eye(3)
    if problem.has("gyro_bias"):
        w = w + x[problem.at("gyro_bias")]
        J[:, t + 3 :, problem.at("gyro_bias")] += np.eye(3)
    if problem.delays:  # a measured rate is not a prediction
        c = t + 3 if rate == "measured" else t + 6
        values = np.concatenate([tau, f, w], axis=1)
        values[:, :c] = problem.delays.late(x, values[:, :c], J[:, :c], nodes)
        tau, f, w = values[:, :t], values[:, t : t + 3], values[:, t + 3 :]
    return tau, f, w


def _momentum(
    s: BlockStack, x: FloatArray, problem: Problem, G: FloatArray, before: Impulse | None
) -> tuple[FloatArray, FloatArray | None, tuple[Impulse | None, ...]]:
    """Return the angular momentum in B (N, 3), its Jacobian (N, 3, p), and that after each block.

    The Jacobian is None where the momentum is zero.
    """
    N = len(s.q_rad)
    after: tuple[Impulse | None, ...] = (None,) * len(s.blocks)
    if not needed(problem) and not problem.has("momentum"):
        return np.zeros((N, 3)), None, after
    L_N, J = np.zeros((N, 3)), np.zeros((N, 3, len(x)))
    if needed(problem):
        ends: list[Impulse | None] = []
        for i, block in enumerate(s.blocks):
            k = slice(i * s.m, (i + 1) * s.m)
            L_N[k], J[k], before = momentum_at_nodes(block, x, problem, G[k], before)
            ends.append(before)
        after = tuple(ends)
    if problem.has("momentum"):
        L_N = L_N + x[problem.at("momentum")]
        J[:, :, problem.at("momentum")] += np.eye(3)
    R_BN = s.R_NB.transpose(0, 2, 1)
    return times(R_BN, L_N), R_BN @ J, after


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
    s = with_bridges(s, problem)
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
    delays = problem.delays
    if delays:  # rows without delays: the noise of motion acts at its own node
        r, s = delays.prompt(x, r, s.m), s.noise_through(delays.back(x, s.m))
    r = r if use.all() else r[:, use]
    S = residual_covariance(s, prediction, use, rate)
    size = S.shape[1]
    D, joins = by_motion(prediction)[:, :, use], problem.is_free
    joined = Joined(s, D, S, r, x, problem.window_s, before, joins=joins)
    at = prediction
    if prediction.D_q is not None and size:
        at = predict(joined.likeliest, x, problem, rate, before)
    J = delays.prompt(x, at.J, s.m) if delays else at.J
    X = (J if use.all() else J[:, use]).reshape(len(s.blocks), size, len(x))
    return joined.rows(X, prediction.each, use)
