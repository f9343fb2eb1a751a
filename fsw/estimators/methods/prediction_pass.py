"""One pass over the samples predicting torque, accelerometer, gyro and base velocity.

The fused model and its projections: RDA is the torque channel at the measured base rate, CM the
gyro (and, in the study, velocity) channel. Equations as in measurement/fused.py; here with the
accelerometer at the base origin, joint accelerations noisy, rates exact.
"""

from __future__ import annotations

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
    shift_base,
    solve_base,
)
from fsw.estimators.methods.gravity_pass import (
    field_base,
    field_tool,
    subtract_field,
)
from fsw.estimators.methods.layout import CHUNK, Channels, Columns, Data, Prediction
from fsw.estimators.methods.linear import (
    divide_rows,
    factor,
    gather,
    gather_rest,
    solve_both,
    whiten,
)
from fsw.estimators.methods.momentum_pass import external, rate_jacobian, turn
from fsw.estimators.projection import observe_motion, project_base, project_tool
from fsw.estimators.spatial import compiled, dot6, inlined
from fsw.messages import FloatArray


@compiled
def prediction_pass(
    arm: Arm, bodies: FloatArray, x: FloatArray, at: Columns, data: Data, use: Channels
) -> FloatArray:
    """Return the Gram (p+1, p+1) of the whitened rows [J | residual] of all samples.

    The last diagonal entry is the sum of squared whitened residuals; NaN where a sample's
    covariance is not positive definite.
    """
    n, p = data.q.shape[1], x.shape[0]
    m = n * use.torque + 3 * use.accelerometer + 3 * use.gyro + 3 * use.velocity
    k, s = new_work(n), new_prediction(data, use, p, m)
    gram = np.zeros((p + 1, p + 1))
    buffer = np.zeros((CHUNK * m, p + 1))
    fill = 0
    for i in range(data.q.shape[0]):
        rows = buffer[fill : fill + m]
        rows[:] = 0.0
        predict_sample(arm, bodies, x, at, data, use, i, k, s)
        fill_residual(x, at, data, use, i, s, rows, n, p)
        if not weigh(data, use, i, k, s, rows):
            gram[p, p] = np.nan
            return gram
        fill_jacobian(x, at, data, use, i, k, s, rows)
        if s.noisy[0] or s.noisy[1]:
            whiten(s.S, rows, m)
        else:
            divide_rows(s.fixed, rows)
        fill = gather(buffer, fill + m, gram)
    gather_rest(buffer, fill, gram)
    return gram


@compiled
def residual_pass(
    arm: Arm, bodies: FloatArray, x: FloatArray, at: Columns, data: Data, use: Channels
) -> FloatArray:
    """Return the whitened residuals (N, m) alone, for input channels without noise."""
    n, p = data.q.shape[1], x.shape[0]
    m = n * use.torque + 3 * use.accelerometer + 3 * use.gyro + 3 * use.velocity
    k, s = new_work(n), new_prediction(data, use, p, m)
    out = np.zeros((data.q.shape[0], m))
    rows = np.zeros((m, p + 1))
    for i in range(data.q.shape[0]):
        predict_sample(arm, bodies, x, at, data, use, i, k, s)
        fill_residual(x, at, data, use, i, s, rows, n, p)
        for c in range(m):
            out[i, c] = rows[c, p] / np.sqrt(s.fixed[c])
    return out


@inlined
def predict_sample(
    arm: Arm, bodies: FloatArray, x: FloatArray, at: Columns, data: Data, use: Channels,
    i: int, k: Work, s: Prediction,
) -> None:  # fmt: skip
    """Fill k and s for sample i: base velocity, base acceleration, torques."""
    configure(arm, bodies, data.q[i], k)
    external(x, at, data, i, k, s)
    if use.measured_rate:
        for c in range(3):
            s.nu[c], s.nu[3 + c] = 0.0, data.w[i, c]
    else:
        n = data.q.shape[1]
        g = s.a  # scratch
        for c in range(6):
            g[c] = 0.0 if c < 3 else s.L[c - 3]
            for j in range(n):
                g[c] -= k.H_bm[j, c] * data.qd[i, j]
        solve_base(k, g, s.nu)
    if use.torque or use.accelerometer:
        solve_motion(data, i, data.qd[i], data.qdd[i], k, s)
    else:
        s.g[:] = 0.0
        accelerate(s.nu[3:], data.qd[i], s.g, data.qdd[i], k)


@inlined
def solve_motion(
    data: Data, i: int, qd: FloatArray, qdd: FloatArray, k: Work, s: Prediction
) -> None:
    """Fill base acceleration, accelerations of all bodies and torques at base rate s.nu.

    In an orbit the acceleration is that against the field about the base's origin, which is what
    an accelerometer there measures.
    """
    g = s.g
    g[:] = 0.0
    accelerate(s.nu[3:], qd, g, qdd, k)
    balance(k, s.tau)
    if data.field.shape[0] > 0:
        subtract_field(data.field[i], k, s.tau)
    for c in range(6):
        g[c] = s.F[c] - k.force[0, c]
    solve_base(k, g, s.a)
    shift_base(k, s.a)
    for j in range(qd.shape[0]):
        s.tau[j] += dot6(k.H_bm[j], s.a)


@inlined
def fill_residual(
    x: FloatArray, at: Columns, data: Data, use: Channels, i: int, s: Prediction,
    rows: FloatArray, n: int, p: int,
) -> None:  # fmt: skip
    """Set the last column of rows to measured less predicted."""
    row = 0
    if use.torque:
        for j in range(n):
            predicted = s.tau[j]
            if at.torque_scale >= 0:
                predicted *= 1.0 + x[at.torque_scale + j]
            if at.torque_offset >= 0:
                predicted += x[at.torque_offset + j]
            rows[j, p] = data.tau[i, j] - predicted
        row = n
    if use.accelerometer:
        for c in range(3):
            bias = x[at.acc_bias + c] if at.acc_bias >= 0 else 0.0
            rows[row + c, p] = data.a[i, c] - s.a[c] - bias
        row += 3
    if use.gyro:
        for c in range(3):
            bias = x[at.gyro_bias + c] if at.gyro_bias >= 0 else 0.0
            rows[row + c, p] = data.w[i, c] - s.nu[3 + c] - bias
        row += 3
    if use.velocity:
        for c in range(3):
            rows[row + c, p] = data.v[i, c] - s.nu[c]


@compiled
def new_prediction(data: Data, use: Channels, p: int, m: int) -> Prediction:
    """Return scratch arrays, the outputs' variances and which inputs are noisy filled in."""
    n = data.q.shape[1]
    fixed = np.zeros(m)
    row = 0
    if use.torque:
        fixed[:n] = data.s_tau**2
        row = n
    if use.accelerometer:
        fixed[row : row + 3] = data.s_a**2
        row += 3
    if use.gyro:
        fixed[row : row + 3] = data.s_w**2
        row += 3
    if use.velocity:
        fixed[row : row + 3] = data.s_v**2
    joints = bool(np.any(data.s_qdd > 0.0)) and (use.torque or use.accelerometer)
    rate = bool(np.any(data.s_w > 0.0)) and use.measured_rate
    return Prediction(
        np.zeros(n), np.zeros(6), np.zeros(6), np.zeros((6, 6)), np.zeros((6, p)), np.zeros(3),
        np.zeros(6), np.zeros(3), np.zeros(6), np.zeros((m, m)), fixed, np.zeros((m, n + 3)),
        np.zeros(m), np.zeros(n), (joints, rate), np.zeros((2, 3)), np.zeros((2, 3, p)),
        np.zeros((2, 10)),
    )  # fmt: skip


@inlined
def weigh(data: Data, use: Channels, i: int, k: Work, s: Prediction, rows: FloatArray) -> bool:
    """Leave the covariance's factor in s.S; move k and s to the smoothed inputs if any is noisy.

    S = output noise + D Sigma D^T over joint acceleration (and the measured rate); the Jacobian is
    taken at input + Sigma D^T S^-1 r, which makes the gradient exact over the latent inputs. False
    if S is not positive definite.
    """
    n, m, p = data.q.shape[1], s.fixed.shape[0], rows.shape[1] - 1
    S, gain, z = s.S, s.gain, s.z
    joints, rate = s.noisy
    if not (joints or rate):
        for c in range(m):
            if not s.fixed[c] > 0.0:
                return False
        return True
    joint_inertia(k)
    if rate:
        _center(data, i, k, s, rows, p)
    if not _covariance(data, use, k, s, False):
        return False
    for c in range(m):
        z[c] = rows[c, p]
    solve_both(S, z, m)
    for j in range(n):
        s.qdd[j] = data.qdd[i, j]
        for c in range(m):
            s.qdd[j] += data.s_qdd[j] * gain[c, j] * z[c]
    if rate:
        for e in range(3):
            for c in range(m):
                s.nu[3 + e] += data.s_w[e] * gain[c, n + e] * z[c]
    solve_motion(data, i, data.qd[i], s.qdd, k, s)
    if rate:
        return bool(_covariance(data, use, k, s, True))
    return True


@inlined
def _center(data: Data, i: int, k: Work, s: Prediction, rows: FloatArray, p: int) -> None:
    """Add to the torque residual the mean that the squared error of the measured rate feigns."""
    n = data.q.shape[1]
    unit, still, zero = k.scratch[0, :3], k.scratch[1], s.qdd
    still[:] = 0.0
    zero[:] = 0.0
    for e in range(3):
        unit[:] = 0.0
        unit[e] = data.s_w[e]
        accelerate(unit, zero, still, zero, k)
        balance(k, s.z[:n])
        for j in range(n):
            rows[j, p] += s.z[j] + dot6(k.N[j], k.force[0])
    solve_motion(data, i, data.qd[i], data.qdd[i], k, s)


@inlined
def _covariance(data: Data, use: Channels, k: Work, s: Prediction, again: bool) -> bool:
    """Leave the factor of the residuals' covariance at the motion in k in s.S."""
    n, m = data.q.shape[1], s.fixed.shape[0]
    S, gain = s.S, s.gain
    joints, rate = s.noisy
    first = n if use.torque else 0
    if joints and not again:
        for j in range(n):
            if use.torque:
                for c in range(n):
                    gain[c, j] = data.s_qdd[j] * (k.H_m[c, j] + dot6(k.H_bm[c], k.N[j]))
            if use.accelerometer:
                for c in range(3):
                    gain[first + c, j] = data.s_qdd[j] * k.N[j, c]
    if rate:
        rate_gradient(k)
        for c in range(n):
            for e in range(3):
                gain[c, n + e] = data.s_w[e] * rate_sensitivity(k, c, e)
    start, stop = 0 if joints else n, n + 3 if rate else n
    for a in range(m):
        for b in range(a + 1):
            total = s.fixed[a] if a == b else 0.0
            for c in range(start, stop):
                total += gain[a, c] * gain[b, c]
            S[a, b] = total
    done: bool = factor(S, m)
    return done


@inlined
def rate_sensitivity(k: Work, j: int, e: int) -> float:
    """Return d tau_j / d w_e at zero external wrench, base acceleration eliminated."""
    total: float = k.C[6 + j, e]
    for c in range(6):
        total += k.N[j, c] * k.C[c, e]
    return total


@inlined
def fill_jacobian(
    x: FloatArray, at: Columns, data: Data, use: Channels, i: int, k: Work, s: Prediction,
    rows: FloatArray,
) -> None:  # fmt: skip
    """Set the first p columns of rows to the Jacobian at the motion in k and s."""
    n, p = data.q.shape[1], x.shape[0]
    chained, field = not use.measured_rate, data.field.shape[0] > 0
    first = 0 if use.accelerometer or use.velocity else 3
    if chained or use.accelerometer:
        unit = s.g
        for c in range(first, 6):
            unit[:] = 0.0
            unit[c] = -1.0
            solve_base(k, unit, s.inverse[c])
    if chained:
        rate_jacobian(at, data, use, i, k, s)
        if use.torque or use.accelerometer:
            rate_gradient(k)
    if use.torque or use.accelerometer:
        observe_motion(k, False)
    row = 0
    if use.torque:
        for j in range(n):
            out = rows[j]
            if at.base >= 0:
                project_base(k, k.N[j], out[at.base : at.base + 10])
            if at.target >= 0:
                project_tool(k, k.N[j], k.S[j], out[at.target : at.target + 10])
            if field:
                if at.base >= 0:
                    field_base(k, data.field[i], k.N[j], s.row[0], out[at.base : at.base + 10])
                if at.target >= 0:
                    own = out[at.target : at.target + 10]
                    field_tool(k, data.field[i], k.N[j], k.S[j], s.row[0], own)
            if at.wrench >= 0:
                turn(data.R[i], k.N[j], out[at.wrench : at.wrench + 6], -1.0)
            if chained:
                for e in range(3):
                    scale = rate_sensitivity(k, j, e)
                    for c in range(p):
                        out[c] += scale * s.J_nu[3 + e, c]
            if at.torque_scale >= 0:
                for c in range(p):
                    out[c] *= 1.0 + x[at.torque_scale + j]
                out[at.torque_scale + j] = s.tau[j]
            if at.torque_offset >= 0:
                out[at.torque_offset + j] = 1.0
        row = n
    if use.accelerometer:
        still = s.g
        still[:] = 0.0
        for f in range(3):
            out = rows[row + f]
            u = s.inverse[f]
            if at.base >= 0:
                project_base(k, u, out[at.base : at.base + 10])
            if at.target >= 0:
                project_tool(k, u, still, out[at.target : at.target + 10])
            if field:
                if at.base >= 0:
                    field_base(k, data.field[i], u, s.row[0], out[at.base : at.base + 10])
                if at.target >= 0:
                    own = out[at.target : at.target + 10]
                    field_tool(k, data.field[i], u, still, s.row[0], own)
            if at.wrench >= 0:
                turn(data.R[i], u, out[at.wrench : at.wrench + 6], -1.0)
            for e in range(3):
                scale = 0.0
                for c in range(6):
                    scale += u[c] * k.C[c, e]
                for c in range(p):
                    out[c] += scale * s.J_nu[3 + e, c]
            if at.acc_bias >= 0:
                out[at.acc_bias + f] = 1.0
        row += 3
    if use.gyro:
        for f in range(3):
            for c in range(p):
                rows[row + f, c] = s.J_nu[3 + f, c]
            if at.gyro_bias >= 0:
                rows[row + f, at.gyro_bias + f] += 1.0
        row += 3
    if use.velocity:
        for f in range(3):
            for c in range(p):
                rows[row + f, c] = s.J_nu[f, c]
