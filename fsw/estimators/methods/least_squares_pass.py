"""One pass of ordinary least squares over base and target, from the measured accelerations.

The recursion runs in the bodies' own frames, the rows stand in the tool's axes: a turn of base
force or moment leaves a plain sum of squares as it is. The rows are gathered in three kinds by the
columns that are not zero in them. Source: paper eqs. (3)-(10); Featherstone (2008), sec. 5.3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fsw.estimators.kernel import Arm
from fsw.estimators.methods.layout import Columns, Data
from fsw.estimators.spatial import compiled, inlined
from fsw.messages import FloatArray

CHUNK = 64  # samples whose rows are gathered for one matrix product
Scalars = tuple[float, float, float]


class Grams(NamedTuple):
    """Grams of the three kinds of rows, right-hand side last in each."""

    force: FloatArray  # (9, 9) base 0-3, target 0-3
    moment: FloatArray  # (20, 20) base 1-9, target 0-9
    joint: FloatArray  # (11, 11) target 0-9


def least_squares_gram(arm: Arm, bodies: FloatArray, at: Columns, data: Data) -> FloatArray:
    """Return the Gram (p+1, p+1) of [Y | r], r the residual at `bodies`; the bodies alone unknown.

    Parameters: `bodies` (n+1, 10) in the turned frames. Rows as in `regression_pass`, unweighted.
    """
    grams = least_squares_pass(arm, bodies, data)
    base, target = list(range(at.base, at.base + 10)), list(range(at.target, at.target + 10))
    p = 10 * ((at.base >= 0) + (at.target >= 0))
    out = np.zeros((p + 1, p + 1))
    for gram, own, tool in (
        (grams.force, range(4), range(4)),
        (grams.moment, range(1, 10), range(10)),
        (grams.joint, range(0), range(10)),
    ):
        columns = [base[i] if at.base >= 0 else -1 for i in own]
        columns += [target[i] if at.target >= 0 else -1 for i in tool]
        columns.append(p)
        keep = [i for i, column in enumerate(columns) if column >= 0]
        to = [columns[i] for i in keep]
        out[np.ix_(to, to)] += gram[np.ix_(keep, keep)]
    return out


@inlined
def _cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> Scalars:
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inlined
def _wrench(b: FloatArray, a: Scalars, d: Scalars, w: Scalars, out: FloatArray) -> None:
    """Set out (6,) = force and moment of a body pi at accelerations a, d and rate w, its axes."""
    m, hx, hy, hz = b[0], b[1], b[2], b[3]
    ax, ay, az = a
    dx, dy, dz = d
    wx, wy, wz = w
    ux, uy, uz = wy * hz - wz * hy, wz * hx - wx * hz, wx * hy - wy * hx
    kx = b[4] * wx + b[5] * wy + b[7] * wz
    ky = b[5] * wx + b[6] * wy + b[8] * wz
    kz = b[7] * wx + b[8] * wy + b[9] * wz
    out[0] = m * ax + dy * hz - dz * hy + wy * uz - wz * uy
    out[1] = m * ay + dz * hx - dx * hz + wz * ux - wx * uz
    out[2] = m * az + dx * hy - dy * hx + wx * uy - wy * ux
    out[3] = b[4] * dx + b[5] * dy + b[7] * dz + wy * kz - wz * ky + hy * az - hz * ay
    out[4] = b[5] * dx + b[6] * dy + b[8] * dz + wz * kx - wx * kz + hz * ax - hx * az
    out[5] = b[7] * dx + b[8] * dy + b[9] * dz + wx * ky - wy * kx + hx * ay - hy * ax


@inlined
def _regressor(a: Scalars, d: Scalars, w: Scalars, Y: FloatArray) -> None:
    """Fill Y (6, 10) of a body in its own axes; entries that are always zero are left alone."""
    ax, ay, az = a
    dx, dy, dz = d
    wx, wy, wz = w
    xy, xz, yz = wx * wy, wx * wz, wy * wz
    xx, yy, zz = wx * wx, wy * wy, wz * wz
    Y[0, 0], Y[0, 1], Y[0, 2], Y[0, 3] = ax, -yy - zz, xy - dz, xz + dy
    Y[1, 0], Y[1, 1], Y[1, 2], Y[1, 3] = ay, xy + dz, -xx - zz, yz - dx
    Y[2, 0], Y[2, 1], Y[2, 2], Y[2, 3] = az, xz - dy, yz + dx, -xx - yy
    Y[3, 2], Y[3, 3] = az, -ay
    Y[4, 1], Y[4, 3] = -az, ax
    Y[5, 1], Y[5, 2] = ay, -ax
    Y[3, 4], Y[3, 5], Y[3, 6] = dx, dy - xz, -yz
    Y[3, 7], Y[3, 8], Y[3, 9] = dz + xy, yy - zz, yz
    Y[4, 4], Y[4, 5], Y[4, 6] = xz, dx + yz, dy
    Y[4, 7], Y[4, 8], Y[4, 9] = zz - xx, dz - xy, -xz
    Y[5, 4], Y[5, 5], Y[5, 6] = -xy, xx - yy, xy
    Y[5, 7], Y[5, 8], Y[5, 9] = dx - yz, dy + xz, dz


@compiled
def least_squares_pass(arm: Arm, bodies: FloatArray, data: Data) -> Grams:
    """Accumulate the three Grams over all samples."""
    N, n = data.q.shape
    out = Grams(np.zeros((9, 9)), np.zeros((20, 20)), np.zeros((11, 11)))
    forces, moments = np.zeros((3 * CHUNK, 9)), np.zeros((3 * CHUNK, 20))
    joints = np.zeros((n * CHUNK, 11))
    R, f = np.zeros((n, 3, 3)), np.zeros((n + 1, 6))
    B, T, M = np.zeros((6, 10)), np.zeros((6, 10)), np.zeros((3, 3))
    fill = 0
    for i in range(N):
        w = (data.w[i, 0], data.w[i, 1], data.w[i, 2])
        d = (data.wd[i, 0], data.wd[i, 1], data.wd[i, 2])
        a = (data.a[i, 0], data.a[i, 1], data.a[i, 2])
        _regressor(a, d, w, B)
        _wrench(bodies[0], a, d, w, f[0])
        for j in range(n):
            c, s = np.cos(data.q[i, j]), np.sin(data.q[i, j])
            u, v, fixed, Q = data.qd[i, j], data.qdd[i, j], arm.R[j], R[j]
            for e in range(3):
                Q[e, 0] = c * fixed[e, 0] + s * fixed[e, 1]
                Q[e, 1] = c * fixed[e, 1] - s * fixed[e, 0]
                Q[e, 2] = fixed[e, 2]
            a, d, w = _onward(Q, arm.p[j], a, d, w)
            d = (d[0] + w[1] * u, d[1] - w[0] * u, d[2] + v)
            w = (w[0], w[1], w[2] + u)
            _wrench(bodies[j + 1], a, d, w, f[j + 1])
        a, d, w = _onward(arm.R_tool, arm.p_tool, a, d, w)
        _regressor(a, d, w, T)
        # M: axes of the current body as seen in the tool's; l: from its origin to the tool's
        lx, ly, lz = 0.0, 0.0, 0.0
        for b in range(3):
            for e in range(3):
                M[b, e] = arm.R_tool[e, b]
        lx, ly, lz = _turn(M, arm.p_tool[0], arm.p_tool[1], arm.p_tool[2])
        for j in range(n - 1, -1, -1):
            zx, zy, zz = M[0, 2], M[1, 2], M[2, 2]
            gx, gy, gz = _cross(zx, zy, zz, lx, ly, lz)
            row = joints[fill * n + j]
            row[0] = gx * T[0, 0] + gy * T[1, 0] + gz * T[2, 0]
            row[1] = gx * T[0, 1] + gy * T[1, 1] + gz * T[2, 1] + zy * T[4, 1] + zz * T[5, 1]
            row[2] = gx * T[0, 2] + gy * T[1, 2] + gz * T[2, 2] + zx * T[3, 2] + zz * T[5, 2]
            row[3] = gx * T[0, 3] + gy * T[1, 3] + gz * T[2, 3] + zx * T[3, 3] + zy * T[4, 3]
            for e in range(4, 10):
                row[e] = zx * T[3, e] + zy * T[4, e] + zz * T[5, e]
            row[10] = data.tau[i, j] - f[j + 1, 5]
            Q, p, own, below = R[j], arm.p[j], f[j + 1], f[j]
            fx, fy, fz = _turn(Q, own[0], own[1], own[2])
            nx, ny, nz = _turn(Q, own[3], own[4], own[5])
            below[0] += fx
            below[1] += fy
            below[2] += fz
            below[3] += nx + p[1] * fz - p[2] * fy
            below[4] += ny + p[2] * fx - p[0] * fz
            below[5] += nz + p[0] * fy - p[1] * fx
            for e in range(3):
                m0, m1, m2 = M[e, 0], M[e, 1], M[e, 2]
                for b in range(3):
                    M[e, b] = m0 * Q[b, 0] + m1 * Q[b, 1] + m2 * Q[b, 2]
            tx, ty, tz = _turn(M, p[0], p[1], p[2])
            lx, ly, lz = lx + tx, ly + ty, lz + tz
        for e in range(3):
            m0, m1, m2 = M[e, 0], M[e, 1], M[e, 2]
            row, low = forces[3 * fill + e], moments[3 * fill + e]
            for b in range(4):
                row[b] = m0 * B[0, b] + m1 * B[1, b] + m2 * B[2, b]
                row[4 + b] = T[e, b]
            row[8] = -(m0 * f[0, 0] + m1 * f[0, 1] + m2 * f[0, 2])
            for b in range(1, 10):
                low[b - 1] = m0 * B[3, b] + m1 * B[4, b] + m2 * B[5, b]
                low[9 + b] = T[3 + e, b]
            low[9] = 0.0
            low[19] = -(m0 * f[0, 3] + m1 * f[0, 4] + m2 * f[0, 5])
        low0, low1, low2 = moments[3 * fill], moments[3 * fill + 1], moments[3 * fill + 2]
        for b in range(4):
            low0[9 + b] += ly * T[2, b] - lz * T[1, b]
            low1[9 + b] += lz * T[0, b] - lx * T[2, b]
            low2[9 + b] += lx * T[1, b] - ly * T[0, b]
        fill += 1
        if fill == CHUNK:
            out.force[:] += np.dot(forces.T, forces)
            out.moment[:] += np.dot(moments.T, moments)
            out.joint[:] += np.dot(joints.T, joints)
            fill = 0
    if fill:
        last = joints[: fill * n]
        out.joint[:] += np.dot(last.T, last)
        forces, moments = forces[: 3 * fill], moments[: 3 * fill]
        out.force[:] += np.dot(forces.T, forces)
        out.moment[:] += np.dot(moments.T, moments)
    return out


@inlined
def _turn(Q: FloatArray, x: float, y: float, z: float) -> Scalars:
    return (
        Q[0, 0] * x + Q[0, 1] * y + Q[0, 2] * z,
        Q[1, 0] * x + Q[1, 1] * y + Q[1, 2] * z,
        Q[2, 0] * x + Q[2, 1] * y + Q[2, 2] * z,
    )


@inlined
def _back(Q: FloatArray, x: float, y: float, z: float) -> Scalars:
    return (
        Q[0, 0] * x + Q[1, 0] * y + Q[2, 0] * z,
        Q[0, 1] * x + Q[1, 1] * y + Q[2, 1] * z,
        Q[0, 2] * x + Q[1, 2] * y + Q[2, 2] * z,
    )


@inlined
def _onward(
    Q: FloatArray, p: FloatArray, a: Scalars, d: Scalars, w: Scalars
) -> tuple[Scalars, Scalars, Scalars]:
    """Return a, d, w of a rigid body's point p, in axes Q (columns in the former axes)."""
    px, py, pz = p[0], p[1], p[2]
    ux, uy, uz = _cross(w[0], w[1], w[2], px, py, pz)
    tx, ty, tz = _cross(d[0], d[1], d[2], px, py, pz)
    cx, cy, cz = _cross(w[0], w[1], w[2], ux, uy, uz)
    return (
        _back(Q, a[0] + tx + cx, a[1] + ty + cy, a[2] + tz + cz),
        _back(Q, d[0], d[1], d[2]),
        _back(Q, w[0], w[1], w[2]),
    )
