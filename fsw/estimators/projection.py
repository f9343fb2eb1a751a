"""Rows of regressors by projection: a vector u on the motion of the base or of the tool's body.

Needs numba, like fsw.estimators.kernel, whose scratch arrays it uses.
"""

from __future__ import annotations

from fsw.estimators.kernel import Work
from fsw.estimators.spatial import inlined
from fsw.messages import FloatArray


@inlined
def observe_motion(k: Work, momentum: bool) -> None:
    """Fill move: classical acceleration of the origin, angular acceleration, rate of both bodies.

    With `momentum` the velocities take the accelerations' place and the rate is zero, which turns
    the force regressor into the momentum regressor.
    """
    n = k.S.shape[0]
    V0, A0 = k.V[0], k.A[0]
    V, A, E = k.V[n], k.A[n], k.E
    px, py, pz = E[3, 0], E[3, 1], E[3, 2]
    cx = V[0] + V[4] * pz - V[5] * py
    cy = V[1] + V[5] * px - V[3] * pz
    cz = V[2] + V[3] * py - V[4] * px
    if momentum:
        for i in range(3):
            k.move[0, i], k.move[0, 3 + i], k.move[0, 6 + i] = V0[i], V0[3 + i], 0.0
            k.move[1, i] = E[0, i] * cx + E[1, i] * cy + E[2, i] * cz
            k.move[1, 3 + i] = E[0, i] * V[3] + E[1, i] * V[4] + E[2, i] * V[5]
            k.move[1, 6 + i] = 0.0
        return
    ax = A[0] + A[4] * pz - A[5] * py + V[4] * cz - V[5] * cy
    ay = A[1] + A[5] * px - A[3] * pz + V[5] * cx - V[3] * cz
    az = A[2] + A[3] * py - A[4] * px + V[3] * cy - V[4] * cx
    for i in range(3):
        k.move[0, i], k.move[0, 3 + i], k.move[0, 6 + i] = A0[i], A0[3 + i], V0[3 + i]
        k.move[1, i] = E[0, i] * ax + E[1, i] * ay + E[2, i] * az
        k.move[1, 3 + i] = E[0, i] * A[3] + E[1, i] * A[4] + E[2, i] * A[5]
        k.move[1, 6 + i] = E[0, i] * V[3] + E[1, i] * V[4] + E[2, i] * V[5]


@inlined
def project(
    move: FloatArray, fx: float, fy: float, fz: float, nx: float, ny: float, nz: float,
    out: FloatArray,
) -> None:  # fmt: skip
    """Set out (10,) = (f, n) . body regressor: a row of Y for a motion vector in the body's frame.

    Source: paper eq. (4) multiplied out from the left.
    """
    ax, ay, az = move[0], move[1], move[2]
    dx, dy, dz = move[3], move[4], move[5]
    wx, wy, wz = move[6], move[7], move[8]
    fw, ww = fx * wx + fy * wy + fz * wz, wx * wx + wy * wy + wz * wz
    gx, gy, gz = ny * wz - nz * wy, nz * wx - nx * wz, nx * wy - ny * wx
    out[0] = fx * ax + fy * ay + fz * az
    out[1] = fy * dz - fz * dy + fw * wx - ww * fx + ay * nz - az * ny
    out[2] = fz * dx - fx * dz + fw * wy - ww * fy + az * nx - ax * nz
    out[3] = fx * dy - fy * dx + fw * wz - ww * fz + ax * ny - ay * nx
    out[4] = nx * dx + gx * wx
    out[5] = nx * dy + ny * dx + gx * wy + gy * wx
    out[6] = ny * dy + gy * wy
    out[7] = nx * dz + nz * dx + gx * wz + gz * wx
    out[8] = ny * dz + nz * dy + gy * wz + gz * wy
    out[9] = nz * dz + gz * wz


@inlined
def project_base(k: Work, u: FloatArray, out: FloatArray) -> None:
    """Set out (10,) = u (6,) . regressor of the base body."""
    project(k.move[0], u[0], u[1], u[2], u[3], u[4], u[5], out)


@inlined
def project_tool(k: Work, u: FloatArray, v: FloatArray, out: FloatArray) -> None:
    """Set out (10,) = (u + v) . regressor of a body at the tool frame, pi in its axes."""
    E = k.E
    nx, ny, nz = u[3] + v[3], u[4] + v[4], u[5] + v[5]
    fx = u[0] + v[0] + ny * E[3, 2] - nz * E[3, 1]
    fy = u[1] + v[1] + nz * E[3, 0] - nx * E[3, 2]
    fz = u[2] + v[2] + nx * E[3, 1] - ny * E[3, 0]
    project(
        k.move[1],
        E[0, 0] * fx + E[1, 0] * fy + E[2, 0] * fz,
        E[0, 1] * fx + E[1, 1] * fy + E[2, 1] * fz,
        E[0, 2] * fx + E[1, 2] * fy + E[2, 2] * fz,
        E[0, 0] * nx + E[1, 0] * ny + E[2, 0] * nz,
        E[0, 1] * nx + E[1, 1] * ny + E[2, 1] * nz,
        E[0, 2] * nx + E[1, 2] * ny + E[2, 2] * nz,
        out,
    )
