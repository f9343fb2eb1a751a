"""One pass over the samples of MRNEA: the regression with measured base acceleration.

Rows: base force and moment (zero, or the external wrench), then joint torques. With a the measured
accelerations, r = y - Y(a) pi has S = H Sigma_a H^T + C Sigma_w C^T + output noise. Source: paper
eqs. (3)-(16); errors in variables as in fsw.estimators.measurement.mrnea, per sample.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fsw.estimators.kernel import (
    Arm,
    Work,
    accelerate,
    balance,
    configure,
    joint_inertia,
    new_work,
    rate_gradient,
)
from fsw.estimators.methods.gravity_pass import field_base, field_tool, subtract_field
from fsw.estimators.methods.inflation import (
    add_sample,
    inflation,
    new_inflation,
    shrinkage,
)
from fsw.estimators.methods.layout import CHUNK, Columns, Data
from fsw.estimators.methods.linear import factor, gather, gather_rest, solve_both, whiten
from fsw.estimators.projection import observe_motion, project_base, project_tool
from fsw.estimators.spatial import compiled, inlined
from fsw.messages import FloatArray

OLS, WLS, EIV = 0, 1, 2


class Regression(NamedTuple):
    """What a pass accumulates. p states, rows whitened."""

    gram: FloatArray  # (p+1, p+1) of [X | r]
    inflation: FloatArray  # (p, p) sum Y_k^T W Y_l P_kl: what input noise adds to X^T W X
    shrinkage: FloatArray  # (p,) sum Y_k^T W H_l P_kl: what it takes from X^T W r
    scores: FloatArray  # (p, p) sum of s s^T, s = X^T W r + shrinkage of one sample; not EIV


class _Sample(NamedTuple):
    """Scratch of one sample."""

    tau: FloatArray  # (n,)
    w: FloatArray  # (3,)
    a: FloatArray  # (6,)
    qdd: FloatArray  # (n,)
    H: FloatArray  # (6+n, 6+n)
    S: FloatArray  # (6+n, 6+n) its factor
    z: FloatArray  # (6+n,)
    sigma: FloatArray  # (9+n,) of a, wd, qdd, w
    gain: FloatArray  # (6+n, 9+n) sensitivity to unit errors of them
    unit: FloatArray  # (6, 6)
    row: FloatArray  # (10,)


@compiled
def regression_pass(
    arm: Arm, bodies: FloatArray, x: FloatArray, at: Columns, data: Data, wrench_sigma: FloatArray,
    mode: int, inflate: bool,
) -> Regression:  # fmt: skip
    """Accumulate the regression at x; `bodies` are those of x (and of the weights).

    `inflate` adds the sums over the inputs' noise P: Sigma_a for OLS and WLS (bias compensation),
    for EIV the covariance left after smoothing, Sigma_a - Sigma_a H^T S^-1 H Sigma_a.
    """
    n, p = data.q.shape[1], x.shape[0]
    m = 6 + n
    k = new_work(n)
    s = _Sample(
        np.zeros(n), np.zeros(3), np.zeros(6), np.zeros(n), np.zeros((m, m)), np.zeros((m, m)),
        np.zeros(m), np.concatenate((data.s_a, data.s_wd, data.s_qdd, data.s_w)),
        np.zeros((m, m + 3)), np.eye(6), np.zeros(10),
    )  # fmt: skip
    out = Regression(np.zeros((p + 1, p + 1)), np.zeros((p, p)), np.zeros(p), np.zeros((p, p)))
    buffer = np.zeros((CHUNK * m, p + 1))
    spread, pull = new_inflation(m), np.zeros(p)
    fill = 0
    for i in range(data.q.shape[0]):
        rows = buffer[fill : fill + m]
        rows[:] = 0.0
        residual(arm, bodies, x, at, data, i, k, s, rows, p)
        if mode != OLS or inflate:
            _mass_matrix(k, s)
        if mode != OLS and not _weigh(data, wrench_sigma, mode, i, k, s, rows):
            out.gram[p, p] = np.nan
            return out
        _fill_rows(x, at, data, i, k, s, rows)
        if mode != OLS:
            whiten(s.S, rows, m)
        if inflate:
            add_sample(at, k, s.H, s.sigma, s.S, mode != OLS, mode == EIV, spread)
        if inflate and mode != EIV:
            shrinkage(at, spread, pull)
            out.shrinkage[:] += pull
            pull += np.dot(np.ascontiguousarray(rows[:, :p]).T, np.ascontiguousarray(rows[:, p]))
            out.scores[:] += np.outer(pull, pull)
        fill = gather(buffer, fill + m, out.gram)
    gather_rest(buffer, fill, out.gram)
    if inflate:
        inflation(at, spread, out.inflation)
    if mode == OLS:
        scale = 1.0 / np.mean(data.s_tau**2)
        out.gram[:] *= scale
        out.inflation[:] *= scale
        out.shrinkage[:] *= scale
        out.scores[:] *= scale**2
    return out


@inlined
def residual(
    arm: Arm, bodies: FloatArray, x: FloatArray, at: Columns, data: Data, i: int, k: Work,
    s: _Sample, rows: FloatArray, p: int,
) -> None:  # fmt: skip
    """Set the last column of rows to y - Y(measured) pi."""
    n = data.q.shape[1]
    configure(arm, bodies, data.q[i], k)
    for c in range(3):
        s.w[c] = data.w[i, c] - (x[at.gyro_bias + c] if at.gyro_bias >= 0 else 0.0)
        s.a[c] = data.a[i, c] - (x[at.acc_bias + c] if at.acc_bias >= 0 else 0.0)
        s.a[3 + c] = data.wd[i, c]
    for j in range(n):
        s.qdd[j] = data.qdd[i, j]
    accelerate(s.w, data.qd[i], s.a, s.qdd, k)
    balance(k, s.tau)
    if data.field.shape[0] > 0:
        subtract_field(data.field[i], k, s.tau)
    for c in range(6):
        rows[c, p] = -k.force[0, c]
    if at.wrench >= 0:
        R = data.R[i]
        for c in range(3):
            for b in range(3):
                rows[c, p] += R[b, c] * x[at.wrench + b]
                rows[3 + c, p] += R[b, c] * x[at.wrench + 3 + b]
    for j in range(n):
        predicted = s.tau[j]
        if at.torque_scale >= 0:
            predicted *= 1.0 + x[at.torque_scale + j]
        if at.torque_offset >= 0:
            predicted += x[at.torque_offset + j]
        rows[6 + j, p] = data.tau[i, j] - predicted


@inlined
def _mass_matrix(k: Work, s: _Sample) -> None:
    joint_inertia(k)
    n, H, J = k.S.shape[0], s.H, k.sum[0]
    for c in range(3):
        H[c, c] = J[0]
    H[1, 3] = H[3, 1] = -J[3]
    H[2, 4] = H[4, 2] = -J[1]
    H[0, 5] = H[5, 0] = -J[2]
    H[0, 4] = H[4, 0] = J[3]
    H[1, 5] = H[5, 1] = J[1]
    H[2, 3] = H[3, 2] = J[2]
    H[3, 3], H[4, 4], H[5, 5] = J[4], J[7], J[9]
    H[3, 4] = H[4, 3] = J[5]
    H[3, 5] = H[5, 3] = J[6]
    H[4, 5] = H[5, 4] = J[8]
    for j in range(n):
        for c in range(6):
            H[c, 6 + j] = H[6 + j, c] = k.H_bm[j, c]
        for c in range(n):
            H[6 + c, 6 + j] = k.H_m[c, j]


@inlined
def _weigh(
    data: Data, wrench_sigma: FloatArray, mode: int, i: int, k: Work,
    s: _Sample, rows: FloatArray,
) -> bool:  # fmt: skip
    """Leave the factor of the rows' covariance in s.S; for EIV move s and k to smoothed inputs."""
    m, p = s.z.shape[0], rows.shape[1] - 1
    S = s.S
    rate = False
    for e in range(3):
        rate = rate or data.s_w[e] > 0.0
    if rate:
        _center(data, i, k, s, rows, p)
    if not _covariance(data, wrench_sigma, k, s, rate):
        return False
    if mode == EIV:
        for c in range(m):
            s.z[c] = rows[c, p]
        solve_both(S, s.z, m)
        for b in range(m + 3):
            step = 0.0
            for c in range(m):
                step += s.gain[c, b] * s.z[c]
            step *= s.sigma[b]
            if b < 6:
                s.a[b] += step
            elif b < m:
                s.qdd[b - 6] += step
            else:
                s.w[b - m] += step
        accelerate(s.w, data.qd[i], s.a, s.qdd, k)
        balance(k, s.tau)
        if rate:
            return bool(_covariance(data, wrench_sigma, k, s, rate))
    return True


@inlined
def _center(data: Data, i: int, k: Work, s: _Sample, rows: FloatArray, p: int) -> None:
    """Add to the residual the mean force that the squared error of the measured rate feigns."""
    n = data.q.shape[1]
    unit, still, zero = k.scratch[0, :3], k.scratch[1], s.z[:n]
    still[:] = 0.0
    zero[:] = 0.0
    for e in range(3):
        unit[:] = 0.0
        unit[e] = data.s_w[e]
        accelerate(unit, zero, still, zero, k)
        balance(k, s.tau)
        for c in range(6):
            rows[c, p] += k.force[0, c]
        for j in range(n):
            rows[6 + j, p] += s.tau[j]
    accelerate(s.w, data.qd[i], s.a, s.qdd, k)
    balance(k, s.tau)


@inlined
def _covariance(data: Data, wrench_sigma: FloatArray, k: Work, s: _Sample, rate: bool) -> bool:
    """Leave the factor of the rows' covariance at the motion in k in s.S."""
    m, S = s.z.shape[0], s.S
    if rate:
        rate_gradient(k)
    for c in range(m):
        for b in range(m):
            s.gain[c, b] = s.H[c, b] * s.sigma[b]
        for e in range(3):
            s.gain[c, m + e] = k.C[c, e] * s.sigma[m + e] if rate else 0.0
    for a in range(m):
        for b in range(a + 1):
            total = 0.0
            for c in range(m + 3):
                total += s.gain[a, c] * s.gain[b, c]
            S[a, b] = total
        S[a, a] += wrench_sigma[a] ** 2 if a < 6 else data.s_tau[a - 6] ** 2
    done: bool = factor(S, m)
    return done


@inlined
def _body_rows(at: Columns, n: int, k: Work, s: _Sample, rows: FloatArray) -> None:
    """Set the bodies' columns for the motion observed in k.move."""
    for c in range(6):
        if at.base >= 0:
            project_base(k, s.unit[c], rows[c, at.base : at.base + 10])
        if at.target >= 0:
            project_tool(k, s.unit[c], k.scratch[0], rows[c, at.target : at.target + 10])
    if at.target >= 0:
        for j in range(n):
            project_tool(k, k.S[j], k.scratch[0], rows[6 + j, at.target : at.target + 10])


@inlined
def _field_rows(at: Columns, w: FloatArray, n: int, k: Work, s: _Sample, rows: FloatArray) -> None:
    """Take the gravity-gradient field's part off the bodies' columns."""
    row, still = s.row, k.scratch[0]
    for c in range(6):
        if at.base >= 0:
            field_base(k, w, s.unit[c], row, rows[c, at.base : at.base + 10])
        if at.target >= 0:
            field_tool(k, w, s.unit[c], still, row, rows[c, at.target : at.target + 10])
    if at.target >= 0:
        for j in range(n):
            field_tool(k, w, k.S[j], still, row, rows[6 + j, at.target : at.target + 10])


@inlined
def _fill_rows(
    x: FloatArray, at: Columns, data: Data, i: int, k: Work, s: _Sample, rows: FloatArray
) -> None:
    n, p = data.q.shape[1], x.shape[0]
    observe_motion(k, False)
    k.scratch[0] = 0.0
    _body_rows(at, n, k, s, rows)
    if data.field.shape[0] > 0:
        _field_rows(at, data.field[i], n, k, s, rows)
    biased = at.acc_bias >= 0 or at.gyro_bias >= 0
    if biased:
        _mass_matrix(k, s)
    if at.acc_bias >= 0:
        for c in range(6 + n):
            for b in range(3):
                rows[c, at.acc_bias + b] = -s.H[c, b]
    if at.gyro_bias >= 0:
        rate_gradient(k)
        for c in range(6 + n):
            for b in range(3):
                rows[c, at.gyro_bias + b] = -k.C[c, b]
    if at.wrench >= 0:
        R = data.R[i]
        for c in range(3):
            for b in range(3):
                rows[c, at.wrench + b] = -R[b, c]
                rows[3 + c, at.wrench + 3 + b] = -R[b, c]
    for j in range(n):
        if at.torque_scale >= 0:
            for c in range(p):
                rows[6 + j, c] *= 1.0 + x[at.torque_scale + j]
            rows[6 + j, at.torque_scale + j] = s.tau[j]
        if at.torque_offset >= 0:
            rows[6 + j, at.torque_offset + j] = 1.0
