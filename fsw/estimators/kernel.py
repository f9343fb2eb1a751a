"""Compiled dynamics of a free-floating serial arm, one sample at a time.

Every vector is taken in base axes about the base origin (spatial notation, linear part first), so
composite inertias add without transforms, a base acceleration adds to every body's alike, and a
row of any regressor is one projection of a vector u on a body's motion: the 6+n rows by 10 (n+1)
columns of the whole regressor are never formed. v_b = 0 throughout (see model/robot.py).

Needs numba; for worker and study, never for the loop process. Pinocchio is the oracle of the tests.
Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 2, 5, 6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fsw.estimators.model.inertia import PARAMETERS, frame_change
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.spatial import (
    compiled,
    dot6,
    factor_base,
    inlined,
    momentum,
    place_inertia,
    routine,
    set_inertia,
)
from fsw.messages import FloatArray


class Arm(NamedTuple):
    """Constants of the arm, every joint frame turned so that z is the joint's axis."""

    R: FloatArray  # (n, 3, 3) joint frame at zero angle in its parent's
    p: FloatArray  # (n, 3)
    R_tool: FloatArray  # (3, 3) tool frame in the last joint's
    p_tool: FloatArray  # (3,)


class Work(NamedTuple):
    """Scratch arrays of one sample; b = 0 is the base, b = j the link after joint j."""

    S: FloatArray  # (n, 6) joint axes
    E: FloatArray  # (4, 3) rotation of the tool frame, then its origin
    own: FloatArray  # (n+1, 10) m, h, Ixx Ixy Ixz Iyy Iyz Izz of every body about the base origin
    sum: FloatArray  # (n+1, 10) the same of everything outward from a body
    V: FloatArray  # (n+1, 6)
    A: FloatArray  # (n+1, 6)
    force: FloatArray  # (n+1, 6) wrench on everything outward from a body
    H_bm: FloatArray  # (n, 6)
    N: FloatArray  # (n, 6) -H_bb^-1 H_bm
    H_m: FloatArray  # (n, n)
    C: FloatArray  # (6+n, 3) d(generalised force)/dw
    base: FloatArray  # (10,) 1/m, centre of mass, inverse central inertia of the whole
    scratch: FloatArray  # (4, 6)
    move: FloatArray  # (2, 9) acceleration, angular acceleration, rate: base in B, tool in E


def build_arm(model: RobotModel) -> tuple[Arm, FloatArray]:
    """Return the arm's constants and T (n+1, 10, 10), pi of each body to the turned frames."""
    pin_model, n = model.model, model.n
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    change = np.empty((n + 1, PARAMETERS, PARAMETERS))
    change[0] = np.eye(PARAMETERS)
    turn = np.eye(3)
    for j in range(n):
        placement = pin_model.jointPlacements[j + 2]
        joint = pin_model.joints[j + 2]
        own = _turn_to(_axis(joint.createData(), joint))
        R[j] = turn.T @ placement.rotation @ own
        p[j] = turn.T @ placement.translation
        change[j + 1] = frame_change(own.T, np.zeros(3))
        turn = own
    R_tool = np.ascontiguousarray(turn.T @ model.tool_map[1:4, 1:4])
    p_tool = np.ascontiguousarray(turn.T @ model.tool_map[1:4, 0])
    return Arm(R, p, R_tool, p_tool), change


def _axis(data: object, joint: object) -> FloatArray:
    joint.calc(data, np.array([0.0]) if joint.nq == 1 else np.array([1.0, 0.0]))  # type: ignore[attr-defined]
    return np.array(data.S).reshape(6)[3:]  # type: ignore[attr-defined]


def _turn_to(axis: FloatArray) -> FloatArray:
    """Return a rotation whose third column is the axis."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)


@compiled
def new_work(n: int) -> Work:
    """Return scratch arrays for n joints."""
    return Work(
        np.zeros((n, 6)),
        np.zeros((4, 3)),
        np.zeros((n + 1, 10)),
        np.zeros((n + 1, 10)),
        np.zeros((n + 1, 6)),
        np.zeros((n + 1, 6)),
        np.zeros((n + 1, 6)),
        np.zeros((n, 6)),
        np.zeros((n, 6)),
        np.zeros((n, n)),
        np.zeros((6 + n, 3)),
        np.zeros(10),
        np.zeros((4, 6)),
        np.zeros((2, 9)),
    )


@routine
def configure(arm: Arm, bodies: FloatArray, q: FloatArray, k: Work) -> None:
    """Fill axes, tool pose, inertias, H_bm, N and the factor of H_bb for joint positions q (n,).

    `bodies` (n+1, 10) are pi of base and links in the turned frames.
    """
    n = q.shape[0]
    own, total = k.own, k.sum
    set_inertia(bodies[0], own[0])
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    px, py, pz = 0.0, 0.0, 0.0
    for j in range(n):
        f, t = arm.R[j], arm.p[j]
        px, py, pz = (
            px + r00 * t[0] + r01 * t[1] + r02 * t[2],
            py + r10 * t[0] + r11 * t[1] + r12 * t[2],
            pz + r20 * t[0] + r21 * t[1] + r22 * t[2],
        )
        c, s = np.cos(q[j]), np.sin(q[j])
        f00, f01 = c * f[0, 0] + s * f[0, 1], c * f[0, 1] - s * f[0, 0]
        f10, f11 = c * f[1, 0] + s * f[1, 1], c * f[1, 1] - s * f[1, 0]
        f20, f21 = c * f[2, 0] + s * f[2, 1], c * f[2, 1] - s * f[2, 0]
        f02, f12, f22 = f[0, 2], f[1, 2], f[2, 2]
        r00, r01, r02 = (
            r00 * f00 + r01 * f10 + r02 * f20,
            r00 * f01 + r01 * f11 + r02 * f21,
            r00 * f02 + r01 * f12 + r02 * f22,
        )
        r10, r11, r12 = (
            r10 * f00 + r11 * f10 + r12 * f20,
            r10 * f01 + r11 * f11 + r12 * f21,
            r10 * f02 + r11 * f12 + r12 * f22,
        )
        r20, r21, r22 = (
            r20 * f00 + r21 * f10 + r22 * f20,
            r20 * f01 + r21 * f11 + r22 * f21,
            r20 * f02 + r21 * f12 + r22 * f22,
        )
        S = k.S[j]
        S[0], S[1], S[2] = py * r22 - pz * r12, pz * r02 - px * r22, px * r12 - py * r02
        S[3], S[4], S[5] = r02, r12, r22
        place_inertia(
            bodies[j + 1], r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz, own[j + 1]
        )
    for i in range(3):
        f, t = arm.R_tool, arm.p_tool
        k.E[0, i] = r00 * f[0, i] + r01 * f[1, i] + r02 * f[2, i]
        k.E[1, i] = r10 * f[0, i] + r11 * f[1, i] + r12 * f[2, i]
        k.E[2, i] = r20 * f[0, i] + r21 * f[1, i] + r22 * f[2, i]
    k.E[3, 0] = px + r00 * t[0] + r01 * t[1] + r02 * t[2]
    k.E[3, 1] = py + r10 * t[0] + r11 * t[1] + r12 * t[2]
    k.E[3, 2] = pz + r20 * t[0] + r21 * t[1] + r22 * t[2]
    for i in range(10):
        total[n, i] = own[n, i]
    for j in range(n - 1, -1, -1):
        for i in range(10):
            total[j, i] = total[j + 1, i] + own[j, i]
    factor_base(total[0], k.base)
    for j in range(n):
        momentum(total[j + 1], k.S[j], k.H_bm[j])
        solve_base(k, k.H_bm[j], k.N[j])
        for i in range(6):
            k.N[j, i] = -k.N[j, i]


@inlined
def solve_base(k: Work, g: FloatArray, out: FloatArray) -> None:
    """Set out = H_bb^-1 g, by way of the centre of mass; g and out (6,)."""
    f = k.base
    cx, cy, cz = f[1], f[2], f[3]
    nx = g[3] - cy * g[2] + cz * g[1]
    ny = g[4] - cz * g[0] + cx * g[2]
    nz = g[5] - cx * g[1] + cy * g[0]
    wx = f[4] * nx + f[5] * ny + f[6] * nz
    wy = f[5] * nx + f[7] * ny + f[8] * nz
    wz = f[6] * nx + f[8] * ny + f[9] * nz
    out[0] = f[0] * g[0] - wy * cz + wz * cy
    out[1] = f[0] * g[1] - wz * cx + wx * cz
    out[2] = f[0] * g[2] - wx * cy + wy * cx
    out[3], out[4], out[5] = wx, wy, wz


@routine
def joint_inertia(k: Work) -> None:
    """Fill H_m (n, n), symmetric."""
    n = k.S.shape[0]
    for j in range(n):
        for i in range(j + 1):
            k.H_m[i, j] = k.H_m[j, i] = dot6(k.S[i], k.H_bm[j])


@routine
def accelerate(w: FloatArray, qd: FloatArray, a: FloatArray, qdd: FloatArray, k: Work) -> None:
    """Fill V and A of every body for base rate w (3,), base acceleration a (6,), joints (n,)."""
    V, A = k.V, k.A
    for i in range(3):
        V[0, i], V[0, 3 + i] = 0.0, w[i]
        A[0, i], A[0, 3 + i] = a[i], a[3 + i]
    for j in range(qd.shape[0]):
        S, v, u = k.S[j], V[j], qd[j]
        s = qdd[j]
        A[j + 1, 0] = (
            A[j, 0] + S[0] * s + u * (v[4] * S[2] - v[5] * S[1] + v[1] * S[5] - v[2] * S[4])
        )
        A[j + 1, 1] = (
            A[j, 1] + S[1] * s + u * (v[5] * S[0] - v[3] * S[2] + v[2] * S[3] - v[0] * S[5])
        )
        A[j + 1, 2] = (
            A[j, 2] + S[2] * s + u * (v[3] * S[1] - v[4] * S[0] + v[0] * S[4] - v[1] * S[3])
        )
        A[j + 1, 3] = A[j, 3] + S[3] * s + u * (v[4] * S[5] - v[5] * S[4])
        A[j + 1, 4] = A[j, 4] + S[4] * s + u * (v[5] * S[3] - v[3] * S[5])
        A[j + 1, 5] = A[j, 5] + S[5] * s + u * (v[3] * S[4] - v[4] * S[3])
        for i in range(6):
            V[j + 1, i] = V[j, i] + S[i] * u


@routine
def balance(k: Work, tau: FloatArray) -> None:
    """Fill force from V and A, and the joint torques tau (n,); force[0] is the base wrench."""
    n = k.S.shape[0]
    for b in range(n, -1, -1):
        J, V, A, o = k.own[b], k.V[b], k.A[b], k.force[b]
        m, hx, hy, hz = J[0], J[1], J[2], J[3]
        vx, vy, vz, wx, wy, wz = V[0], V[1], V[2], V[3], V[4], V[5]
        lx = m * vx + wy * hz - wz * hy
        ly = m * vy + wz * hx - wx * hz
        lz = m * vz + wx * hy - wy * hx
        kx = hy * vz - hz * vy + J[4] * wx + J[5] * wy + J[6] * wz
        ky = hz * vx - hx * vz + J[5] * wx + J[7] * wy + J[8] * wz
        kz = hx * vy - hy * vx + J[6] * wx + J[8] * wy + J[9] * wz
        ax, ay, az, dx, dy, dz = A[0], A[1], A[2], A[3], A[4], A[5]
        o[0] = m * ax + dy * hz - dz * hy + wy * lz - wz * ly
        o[1] = m * ay + dz * hx - dx * hz + wz * lx - wx * lz
        o[2] = m * az + dx * hy - dy * hx + wx * ly - wy * lx
        o[3] = (hy * az - hz * ay + J[4] * dx + J[5] * dy + J[6] * dz
                + wy * kz - wz * ky + vy * lz - vz * ly)  # fmt: skip
        o[4] = (hz * ax - hx * az + J[5] * dx + J[7] * dy + J[8] * dz
                + wz * kx - wx * kz + vz * lx - vx * lz)  # fmt: skip
        o[5] = (hx * ay - hy * ax + J[6] * dx + J[8] * dy + J[9] * dz
                + wx * ky - wy * kx + vx * ly - vy * lx)  # fmt: skip
        if b < n:
            for i in range(6):
                o[i] += k.force[b + 1, i]
        if b > 0:
            tau[b - 1] = dot6(k.S[b - 1], o)


@inlined
def shift_base(k: Work, a: FloatArray) -> None:
    """Add a base acceleration a (6,) to every body's."""
    for b in range(k.A.shape[0]):
        for i in range(6):
            k.A[b, i] += a[i]


@routine
def rate_gradient(k: Work) -> None:
    """Fill C (6+n, 3) = d(generalised force)/dw at fixed a and qdd, from own and V.

    With e a unit base rate: dV = e, dA = e x (V - V_0), so a body's force changes by
    J (e x V_rel) + e x* J V + V x* J e.
    """
    n = k.S.shape[0]
    rel, P, d, g = k.scratch[0], k.scratch[1], k.scratch[2], k.scratch[3]
    for e in range(3):
        i1, i2 = (e + 1) % 3, (e + 2) % 3
        t0 = t1 = t2 = t3 = t4 = t5 = 0.0
        for b in range(n, -1, -1):
            J, V = k.own[b], k.V[b]
            for i in range(2):
                # e x (y at i1, y at i2): component i1 is -y[i2], component i2 is y[i1]
                o = 3 * i
                rel[o + e] = 0.0
                rel[o + i1] = -(V[o + i2] - k.V[0, o + i2])
                rel[o + i2] = V[o + i1] - k.V[0, o + i1]
            momentum(J, rel, d)
            momentum(J, V, P)
            for i in range(2):
                o = 3 * i
                d[o + i1] -= P[o + i2]
                d[o + i2] += P[o + i1]
            for i in range(6):
                g[i] = 0.0
            g[i1], g[i2] = -J[1 + i2], J[1 + i1]
            g[3], g[4], g[5] = (
                J[4 + e], (J[5], J[7], J[8])[e], (J[6], J[8], J[9])[e])  # fmt: skip
            vx, vy, vz, wx, wy, wz = V[0], V[1], V[2], V[3], V[4], V[5]
            t0 += d[0] + wy * g[2] - wz * g[1]
            t1 += d[1] + wz * g[0] - wx * g[2]
            t2 += d[2] + wx * g[1] - wy * g[0]
            t3 += d[3] + wy * g[5] - wz * g[4] + vy * g[2] - vz * g[1]
            t4 += d[4] + wz * g[3] - wx * g[5] + vz * g[0] - vx * g[2]
            t5 += d[5] + wx * g[4] - wy * g[3] + vx * g[1] - vy * g[0]
            if b > 0:
                S = k.S[b - 1]
                k.C[5 + b, e] = (
                    S[0] * t0 + S[1] * t1 + S[2] * t2 + S[3] * t3 + S[4] * t4 + S[5] * t5
                )
        k.C[0, e], k.C[1, e], k.C[2, e] = t0, t1, t2
        k.C[3, e], k.C[4, e], k.C[5, e] = t3, t4, t5
