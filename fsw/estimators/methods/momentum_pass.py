"""Angular momentum from outside, and the base velocity's derivatives, sample by sample."""

from __future__ import annotations

from fsw.estimators.kernel import Work
from fsw.estimators.methods.gravity_pass import gain, gain_jacobian
from fsw.estimators.methods.layout import Channels, Columns, Data, Prediction
from fsw.estimators.projection import observe_motion, project_base, project_tool
from fsw.estimators.spatial import inlined
from fsw.messages import FloatArray


@inlined
def external(x: FloatArray, at: Columns, data: Data, i: int, k: Work, s: Prediction) -> None:
    """Fill external wrench and angular momentum in base axes; both constant in N but for torque.

    dL/dt = n - (c x f) about the centre of mass, f at the base origin; time from the first sample.
    """
    oriented = data.field.shape[0] > 0
    if at.momentum < 0 and at.wrench < 0 and not oriented:
        return
    R = data.R[i]
    L = s.g
    if oriented:
        gain(data, i, k, s)
    for c in range(3):
        L[c] = x[at.momentum + c] if at.momentum >= 0 else 0.0
        L[c] += s.gained[0, c]
    if at.wrench >= 0:
        f, moment = x[at.wrench : at.wrench + 3], x[at.wrench + 3 : at.wrench + 6]
        if i == 0:
            s.lever[:] = 0.0
        else:
            dt = data.t[i] - data.t[i - 1]
            for c in range(3):
                s.lever[c] -= dt * (R[c, 0] * k.base[1] + R[c, 1] * k.base[2] + R[c, 2] * k.base[3])
        t = data.t[i] - data.t[0]
        for c in range(3):
            c1, c2 = (c + 1) % 3, (c + 2) % 3
            L[c] += t * moment[c] + s.lever[c1] * f[c2] - s.lever[c2] * f[c1]
            s.F[c] = R[0, c] * f[0] + R[1, c] * f[1] + R[2, c] * f[2]
            s.F[3 + c] = R[0, c] * moment[0] + R[1, c] * moment[1] + R[2, c] * moment[2]
    for c in range(3):
        s.L[c] = R[0, c] * L[0] + R[1, c] * L[1] + R[2, c] * L[2]


@inlined
def turn(R: FloatArray, u: FloatArray, out: FloatArray, sign: float) -> None:
    """Set out (6,) = sign * u . d(wrench in B)/d(wrench in N)."""
    for c in range(3):
        out[c] = sign * (R[c, 0] * u[0] + R[c, 1] * u[1] + R[c, 2] * u[2])
        out[3 + c] = sign * (R[c, 0] * u[3] + R[c, 1] * u[4] + R[c, 2] * u[5])


@inlined
def rate_jacobian(at: Columns, data: Data, use: Channels, i: int, k: Work, s: Prediction) -> None:
    """Fill J_nu = -H_bb^-1 Y(q, 0, nu)_b and the columns of momentum, field and wrench.

    Its first three rows only where the base velocity is a channel: nothing else depends on them.
    nu is the full predicted velocity: v_b is put back into V for the projection, then removed.
    """
    n = data.q.shape[1]
    if data.field.shape[0] > 0:
        gain_jacobian(at, data, i, k, s)
    for c in range(3):
        k.V[0, c] += s.nu[c]
        k.V[n, c] += s.nu[c]
    observe_motion(k, True)
    for c in range(3):
        k.V[0, c] -= s.nu[c]
        k.V[n, c] -= s.nu[c]
    still, R, lever = s.g, data.R[i], s.lever
    still[:] = 0.0
    t = data.t[i] - data.t[0]
    for f in range(0 if use.velocity else 3, 6):
        u = s.inverse[f]
        if at.base >= 0:
            project_base(k, u, s.J_nu[f, at.base : at.base + 10])
        if at.target >= 0:
            project_tool(k, u, still, s.J_nu[f, at.target : at.target + 10])
        if at.momentum < 0 and at.wrench < 0 and data.field.shape[0] == 0:
            continue
        y0 = -(R[0, 0] * u[3] + R[0, 1] * u[4] + R[0, 2] * u[5])
        y1 = -(R[1, 0] * u[3] + R[1, 1] * u[4] + R[1, 2] * u[5])
        y2 = -(R[2, 0] * u[3] + R[2, 1] * u[4] + R[2, 2] * u[5])
        if data.field.shape[0] > 0:
            for c in range(s.J_nu.shape[1]):
                s.J_nu[f, c] += (
                    y0 * s.J_gained[0, 0, c] + y1 * s.J_gained[0, 1, c] + y2 * s.J_gained[0, 2, c]
                )
        if at.momentum >= 0:
            s.J_nu[f, at.momentum] = y0
            s.J_nu[f, at.momentum + 1] = y1
            s.J_nu[f, at.momentum + 2] = y2
        if at.wrench >= 0:
            # y . (lever x f) = f . (y x lever)
            out = s.J_nu[f, at.wrench : at.wrench + 6]
            out[0] = y1 * lever[2] - y2 * lever[1]
            out[1] = y2 * lever[0] - y0 * lever[2]
            out[2] = y0 * lever[1] - y1 * lever[0]
            out[3], out[4], out[5] = t * y0, t * y1, t * y2
