"""Whitened rows of every sample, and how they change with the joints' motion.

For a motion that is itself uncertain: see fsw.estimators.methods.motion.
"""

from __future__ import annotations

import numpy as np

from fsw.estimators.kernel import Arm, new_work
from fsw.estimators.methods.layout import Channels, Columns, Data
from fsw.estimators.methods.linear import divide_rows
from fsw.estimators.methods.prediction_pass import (
    fill_jacobian,
    fill_residual,
    new_prediction,
    predict_sample,
)
from fsw.estimators.spatial import compiled
from fsw.messages import FloatArray

STEP = 1e-6  # rad, rad/s, rad/s^2: of central differences, exact to 1e-9 of the derivative


@compiled
def row_pass(
    arm: Arm, bodies: FloatArray, x: FloatArray, at: Columns, data: Data, use: Channels
) -> FloatArray:
    """Return [J | residual] of every sample (N, m, p+1), each row over its output's sigma.

    Joint motion and rate are taken as exact.
    """
    n, p = data.q.shape[1], x.shape[0]
    m = n * use.torque + 3 * use.accelerometer + 3 * use.gyro + 3 * use.velocity
    k, s = new_work(n), new_prediction(data, use, p, m)
    out = np.zeros((data.q.shape[0], m, p + 1))
    for i in range(data.q.shape[0]):
        predict_sample(arm, bodies, x, at, data, use, i, k, s)
        fill_residual(x, at, data, use, i, s, out[i], n, p)
        fill_jacobian(x, at, data, use, i, k, s, out[i])
        divide_rows(s.fixed, out[i])
    return out


@compiled
def motion_gradient(
    arm: Arm, bodies: FloatArray, x: FloatArray, at: Columns, data: Data, use: Channels
) -> FloatArray:
    """Return d(predicted)/d(q, qd, qdd) of every sample (N, m, 3, n), over the output's sigma.

    By central differences; the momentum gained before a sample is taken as given.
    """
    n, p = data.q.shape[1], x.shape[0]
    m = n * use.torque + 3 * use.accelerometer + 3 * use.gyro + 3 * use.velocity
    k, s = new_work(n), new_prediction(data, use, p, m)
    out = np.zeros((data.q.shape[0], m, 3, n))
    rows = np.zeros((m, p + 1))
    q, qd, qdd = data.q.copy(), data.qd.copy(), data.qdd.copy()
    at_motion = Data(
        data.t, q, qd, qdd, data.tau, data.w, data.wd, data.a, data.v, data.R, data.field,
        data.s_tau, data.s_qdd, data.s_w, data.s_wd, data.s_a, data.s_v,
    )  # fmt: skip
    for order in range(3):
        moved = q if order == 0 else qd if order == 1 else qdd
        for j in range(n):
            for sign in (-1.0, 1.0):
                kept = moved[:, j].copy()
                for i in range(kept.shape[0]):
                    moved[i, j] = kept[i] + sign * STEP
                for i in range(kept.shape[0]):
                    predict_sample(arm, bodies, x, at, at_motion, use, i, k, s)
                    fill_residual(x, at, at_motion, use, i, s, rows, n, p)
                    for c in range(m):
                        out[i, c, order, j] -= (
                            sign * rows[c, p] / (2.0 * STEP * np.sqrt(s.fixed[c]))
                        )
                for i in range(kept.shape[0]):
                    moved[i, j] = kept[i]
    return out
