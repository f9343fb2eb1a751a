"""Gravity gradient in the compiled passes: field, its wrench, and the rows it adds.

The field about the base's origin is the acceleration G s of an element at s, G = mu/R^3 (3 r r^T -
1), r the unit vector to the zenith. With w = sqrt(3 mu/R^3) r it is that of a body turning at w,
w w^T - w.w, plus 2/3 w.w times s, which has no moment: so the regressor's projection serves again.
Source: paper eq. (26), as a field acting on every mass element (see fsw.estimators.model.orbit).
"""

from __future__ import annotations

from fsw.estimators.kernel import Work
from fsw.estimators.methods.layout import Columns, Data, Prediction
from fsw.estimators.projection import project
from fsw.estimators.spatial import dot6, routine
from fsw.messages import FloatArray


@routine
def field_wrench(J: FloatArray, w: FloatArray, out: FloatArray) -> None:
    """Set out (6,) = force and moment about the base origin on the inertia J (10,)."""
    along = w[0] * J[1] + w[1] * J[2] + w[2] * J[3]
    third = (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) / 3.0
    out[0] = w[0] * along - third * J[1]
    out[1] = w[1] * along - third * J[2]
    out[2] = w[2] * along - third * J[3]
    kx = J[4] * w[0] + J[5] * w[1] + J[6] * w[2]
    ky = J[5] * w[0] + J[7] * w[1] + J[8] * w[2]
    kz = J[6] * w[0] + J[8] * w[1] + J[9] * w[2]
    out[3] = w[1] * kz - w[2] * ky
    out[4] = w[2] * kx - w[0] * kz
    out[5] = w[0] * ky - w[1] * kx


@routine
def subtract_field(w: FloatArray, k: Work, tau: FloatArray) -> None:
    """Take the field's wrench off the base wrench in k.force[0] and off the torques tau (n,)."""
    out = k.scratch[1]
    for j in range(tau.shape[0]):
        field_wrench(k.sum[j + 1], w, out)
        tau[j] -= dot6(k.S[j], out)
    field_wrench(k.sum[0], w, out)
    for c in range(6):
        k.force[0, c] -= out[c]


@routine
def field_base(k: Work, w: FloatArray, u: FloatArray, row: FloatArray, out: FloatArray) -> None:
    """Take u (6,) . d(field wrench on the base)/d pi off out (10,)."""
    move = k.move[0]
    field_row(0.0, 0.0, 0.0, w[0], w[1], w[2], u[0], u[1], u[2], u[3], u[4], u[5], move, row)
    for c in range(10):
        out[c] -= row[c]


@routine
def field_tool(
    k: Work, w: FloatArray, u: FloatArray, v: FloatArray, row: FloatArray, out: FloatArray
) -> None:
    """Take (u + v) . d(field wrench on a body at the tool frame)/d pi off out (10,)."""
    E = k.E
    px, py, pz = E[3, 0], E[3, 1], E[3, 2]
    along = w[0] * px + w[1] * py + w[2] * pz
    third = (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) / 3.0
    ax, ay, az = w[0] * along - third * px, w[1] * along - third * py, w[2] * along - third * pz
    nx, ny, nz = u[3] + v[3], u[4] + v[4], u[5] + v[5]
    fx = u[0] + v[0] + ny * pz - nz * py
    fy = u[1] + v[1] + nz * px - nx * pz
    fz = u[2] + v[2] + nx * py - ny * px
    field_row(
        E[0, 0] * ax + E[1, 0] * ay + E[2, 0] * az,
        E[0, 1] * ax + E[1, 1] * ay + E[2, 1] * az,
        E[0, 2] * ax + E[1, 2] * ay + E[2, 2] * az,
        E[0, 0] * w[0] + E[1, 0] * w[1] + E[2, 0] * w[2],
        E[0, 1] * w[0] + E[1, 1] * w[1] + E[2, 1] * w[2],
        E[0, 2] * w[0] + E[1, 2] * w[1] + E[2, 2] * w[2],
        E[0, 0] * fx + E[1, 0] * fy + E[2, 0] * fz,
        E[0, 1] * fx + E[1, 1] * fy + E[2, 1] * fz,
        E[0, 2] * fx + E[1, 2] * fy + E[2, 2] * fz,
        E[0, 0] * nx + E[1, 0] * ny + E[2, 0] * nz,
        E[0, 1] * nx + E[1, 1] * ny + E[2, 1] * nz,
        E[0, 2] * nx + E[1, 2] * ny + E[2, 2] * nz,
        k.move[1],
        row,
    )
    for c in range(10):
        out[c] -= row[c]


@routine
def field_row(
    ax: float, ay: float, az: float, wx: float, wy: float, wz: float,
    fx: float, fy: float, fz: float, nx: float, ny: float, nz: float,
    move: FloatArray, row: FloatArray,
) -> None:  # fmt: skip
    """Set row (10,) = (f, n) . field regressor in a body's frame; a the field at its origin.

    `move` is borrowed and given back.
    """
    b0, b1, b2, b3, b4 = move[0], move[1], move[2], move[3], move[4]
    b5, b6, b7, b8 = move[5], move[6], move[7], move[8]
    move[0], move[1], move[2] = ax, ay, az
    move[3], move[4], move[5] = 0.0, 0.0, 0.0
    move[6], move[7], move[8] = wx, wy, wz
    project(move, fx, fy, fz, nx, ny, nz, row)
    even = 2.0 / 3.0 * (wx * wx + wy * wy + wz * wz)
    row[1] += even * fx
    row[2] += even * fy
    row[3] += even * fz
    move[0], move[1], move[2], move[3], move[4] = b0, b1, b2, b3, b4
    move[5], move[6], move[7], move[8] = b5, b6, b7, b8


@routine
def gain(data: Data, i: int, k: Work, s: Prediction) -> None:
    """Add the moment about the centre of mass since the last sample to s.gained, in N."""
    out, R, f = k.scratch[1], data.R[i], k.base
    field_wrench(k.sum[0], data.field[i], out)
    mx = out[3] - f[2] * out[2] + f[3] * out[1]
    my = out[4] - f[3] * out[0] + f[1] * out[2]
    mz = out[5] - f[1] * out[1] + f[2] * out[0]
    half = 0.5 * (data.t[i] - data.t[i - 1]) if i > 0 else 0.0
    for c in range(3):
        moment = R[c, 0] * mx + R[c, 1] * my + R[c, 2] * mz
        s.gained[0, c] = s.gained[0, c] + half * (s.gained[1, c] + moment) if i > 0 else 0.0
        s.gained[1, c] = moment


@routine
def gain_jacobian(at: Columns, data: Data, i: int, k: Work, s: Prediction) -> None:
    """Add the derivative of the moment since the last sample to s.J_gained.

    d(n - c x f) = dn - c x df - dc x f, with dc = (dh - c dm)/m.
    """
    w, R, base = data.field[i], data.R[i], k.base
    wrench, u, still, d = k.scratch[1], k.scratch[2], k.scratch[3], s.g
    field_wrench(k.sum[0], w, wrench)
    still[:] = 0.0
    half = 0.5 * (data.t[i] - data.t[i - 1]) if i > 0 else 0.0
    for tool in range(2):
        first = at.target if tool == 1 else at.base
        if first < 0:
            continue
        for c in range(3):
            # r: axis c of N in B; r . (dn - c x df) = (c x r, r) . d(wrench)
            rx, ry, rz = R[c, 0], R[c, 1], R[c, 2]
            u[0] = base[2] * rz - base[3] * ry
            u[1] = base[3] * rx - base[1] * rz
            u[2] = base[1] * ry - base[2] * rx
            u[3], u[4], u[5] = rx, ry, rz
            d10 = s.row[1]
            d10[:] = 0.0
            if tool == 1:
                field_tool(k, w, u, still, s.row[0], d10)
            else:
                field_base(k, w, u, s.row[0], d10)
            # - r . (dc x f) = - (f x r) . dc
            gx = wrench[1] * rz - wrench[2] * ry
            gy = wrench[2] * rx - wrench[0] * rz
            gz = wrench[0] * ry - wrench[1] * rx
            along = gx * base[1] + gy * base[2] + gz * base[3]
            d[0], d[1], d[2] = gx, gy, gz
            if tool == 1:
                E = k.E
                along -= gx * E[3, 0] + gy * E[3, 1] + gz * E[3, 2]
                for e in range(3):
                    d[e] = E[0, e] * gx + E[1, e] * gy + E[2, e] * gz
            for e in range(10):
                value = -d10[e]
                if e == 0:
                    value += base[0] * along
                elif e < 4:
                    value -= base[0] * d[e - 1]
                J = s.J_gained
                before = J[1, c, first + e]
                J[0, c, first + e] = J[0, c, first + e] + half * (before + value) if i > 0 else 0.0
                J[1, c, first + e] = value
