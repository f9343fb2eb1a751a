"""Jacobians of the fused prediction, from its dynamics; equations and symbols as in `fused`."""

import numpy as np

from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.dynamics import Dynamics
from fsw.estimators.measurement.impulse import external_force, pulled
from fsw.estimators.measurement.mounting import fill_gyro_columns, gyro_turn, turn
from fsw.estimators.measurement.prediction import Rate
from fsw.estimators.model.inertia import skew
from fsw.estimators.model.problem import Problem
from fsw.messages import FloatArray


def state_gains(
    s: BlockStack,
    x: FloatArray,
    problem: Problem,
    d: Dynamics,
    J_L: FloatArray | None,
    r: FloatArray,
) -> FloatArray:
    """Return d[tau; f; w]/d[qdd, w, qd, x] (N, t + 6, 2 n + 3 + p) without the sensors' own errors.

    The base rows of the direct effect on the generalised force give the base's acceleration, which
    acts on torque and specific force. What changes the rate acts on both through the rate.
    """
    n, w, lever = s.n, d.nu[:, 3:], np.concatenate([np.eye(3), -skew(r)], axis=1)
    t = d.force.shape[1]
    direct = np.zeros((len(w), 6 + t, 2 * n + 3 + len(x)))
    direct[:, :, :n], direct[:, :, n : 2 * n + 3] = d.H[:, :, 6:], d.C[:, :, 3:]
    by_state = direct[:, :, 2 * n + 3 :]
    by_state[:, :, problem.inertial] = d.Y
    if pulled(problem):
        by_state -= external_force(s, x, problem)[1]
    if d.carried is not None:
        by_state[:, 3:6] += d.carried.by_state(w)
    base = -(d.H_bb_inverse @ direct[:, :6])
    D = np.empty((len(w), t + 6, direct.shape[2]))
    D[:, :t] = direct[:, 6:] + d.H[:, 6:, :6] @ base
    D[:, t : t + 3] = lever @ base
    D_w = D[:, : t + 3, n : n + 3]  # w x (w x r) = w (w.r) - r (w.w)
    D_w[:, t:] += (w @ r)[:, None, None] * np.eye(3) + w[:, :, None] * r
    D_w[:, t:] -= 2.0 * r[:, None] * w[:, None, :]
    D[:, t + 3 :] = 0.0
    rate = D[:, t + 3 :, n + 3 :]  # by qd and x
    if d.Y_h is not None:
        rate[:, :, :n] = base[:, 3:, :n]
        rate[:, :, n:][:, :, problem.inertial] = -(d.H_bb_inverse[:, 3:] @ d.Y_h)
        if J_L is not None:
            rate[:, :, n:] += d.H_bb_inverse[:, 3:, 3:] @ J_L
    else:
        own = rate[:, :, n:]
        if problem.has("gyro_bias"):
            own[:, :, problem.at("gyro_bias")] = -gyro_turn(x, problem)
        if problem.has("imu_angle"):
            own[:, :, problem.at("imu_angle")] = -skew(w) @ turn(x, problem)[1]
        fill_gyro_columns(own, np.broadcast_to(np.eye(3), (len(w), 3, 3)), w, x, problem)
        if problem.delays:
            slope = problem.delays.slope(w, s.m)[:, :, None]
            own[:, :, problem.delays.states] += slope * problem.delays.of_channels[-3:]
    D[:, : t + 3, n + 3 :] += D_w @ rate
    return D


def by_place(wd: FloatArray, w: FloatArray) -> FloatArray:
    """Return d(wd x r + w x (w x r))/dr (N, 3, 3)."""
    turned: FloatArray = skew(wd) + skew(w) @ skew(w)
    return turned


def angle_gain(d: Dynamics, D_w: FloatArray, r: FloatArray, rate: Rate) -> FloatArray | None:
    """Return d[tau; f; w]/dq (m, t + 6, n) without external wrench; None where angles are exact."""
    if d.by_angle is None or d.h_by_angle is None:
        return None
    n = d.by_angle.shape[2]
    reaction = -d.H_bb_inverse @ np.concatenate([d.by_angle[:, :6], d.h_by_angle], axis=2)
    a_q, w_q = reaction[:, :, :n], reaction[:, 3:, n:]
    if rate == "measured":
        w_q = np.zeros_like(w_q)
    lever = np.concatenate([np.eye(3), -skew(r)], axis=1)
    tau_q = d.by_angle[:, 6:] + d.H[:, 6:, :6] @ a_q
    direct = np.concatenate([tau_q, lever @ a_q], axis=1)
    return np.concatenate([direct + D_w @ w_q, w_q], axis=1)


def carried_gain(d: Dynamics, D_w: FloatArray, r: FloatArray, rate: Rate) -> FloatArray | None:
    """Return d[tau; f; w]/d[h, d/dt h] (2, m, t + 6, k) that are carried; None if none is."""
    if d.carried is None:
        return None
    lever = np.concatenate([np.eye(3), -skew(r)], axis=1)
    t, w = d.force.shape[1], d.nu[:, 3:]
    base = -(d.H_bb_inverse[:, :, 3:] @ d.carried.by_motion(w))
    D = np.zeros((*base.shape[:2], t + 6, base.shape[3]))
    D[:, :, :t], D[:, :, t : t + 3] = d.H[:, 6:, :6] @ base, lever @ base
    if rate == "momentum":
        D[0, :, t + 3 :] = -(d.H_bb_inverse[:, 3:, 3:] @ d.carried.axes)
        D[0, :, : t + 3] += D_w @ D[0, :, t + 3 :]
    return D
