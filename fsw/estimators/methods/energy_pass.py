"""One pass over the samples of the kinetic energy and its gradient at zero momentum."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fsw.estimators.kernel import Arm, Work, configure, joint_inertia, new_work, solve_base
from fsw.estimators.methods.gravity_pass import field_base, field_tool, field_wrench
from fsw.estimators.methods.layout import Columns
from fsw.estimators.projection import observe_motion, project_base, project_tool
from fsw.estimators.spatial import compiled, dot6
from fsw.messages import FloatArray


class Energy(NamedTuple):
    """Kinetic energy of N samples."""

    T: FloatArray  # (N,) 1/2 qd^T H^ qd
    J: FloatArray  # (N, p) dT/dx: 1/2 nu^T Y(q, 0, nu), nu the whole predicted velocity
    momentum: FloatArray  # (N, n) H^ qd
    diagonal: FloatArray  # (N, n) of H^
    P: FloatArray  # (N,) power of the gravity gradient, zero without an orbit
    J_P: FloatArray  # (N, p)


@compiled
def energy_pass(
    arm: Arm, bodies: FloatArray, p: int, at: Columns, q: FloatArray, qd: FloatArray,
    field: FloatArray,
) -> Energy:  # fmt: skip
    """Return energy, gradient, what the rates' noise does to it, and the field's power.

    `field` as in `Data`. The base velocity's own derivative is left out of the power's, which is
    itself some 1e-5 of the motors'.
    """
    N, n = q.shape
    k = new_work(n)
    out = Energy(
        np.zeros(N), np.zeros((N, p)), np.zeros((N, n)), np.zeros((N, n)), np.zeros(N),
        np.zeros((N, p)),
    )  # fmt: skip
    row = np.zeros(10)
    g, nu, half, still = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6)
    for i in range(N):
        configure(arm, bodies, q[i], k)
        joint_inertia(k)
        for c in range(6):
            g[c] = 0.0
            for j in range(n):
                g[c] -= k.H_bm[j, c] * qd[i, j]
        solve_base(k, g, nu)
        for c in range(6):
            k.V[0, c] = nu[c]
            total = nu[c]
            for j in range(n):
                total += k.S[j, c] * qd[i, j]
            k.V[n, c] = total
        observe_motion(k, True)
        if at.base >= 0:
            for c in range(6):
                half[c] = 0.5 * k.V[0, c]
            project_base(k, half, out.J[i, at.base : at.base + 10])
        if at.target >= 0:
            for c in range(6):
                half[c] = 0.5 * k.V[n, c]
            project_tool(k, half, still, out.J[i, at.target : at.target + 10])
        for j in range(n):
            total = dot6(k.H_bm[j], nu)
            for c in range(n):
                total += k.H_m[j, c] * qd[i, c]
            out.momentum[i, j] = total
            out.diagonal[i, j] = k.H_m[j, j] + dot6(k.H_bm[j], k.N[j])
            out.T[i] += 0.5 * total * qd[i, j]
        if field.shape[0] > 0:
            _power(at, field[i], qd[i], nu, k, row, i, out)
    return out


@compiled
def _power(
    at: Columns, w: FloatArray, qd: FloatArray, nu: FloatArray, k: Work, row: FloatArray, i: int,
    out: Energy,
) -> None:  # fmt: skip
    """Set power and its derivative of sample i: wrench of the field on what is outward, by rate."""
    wrench, tip, still = k.scratch[1], k.scratch[2], k.scratch[3]
    field_wrench(k.sum[0], w, wrench)
    out.P[i] = dot6(nu, wrench)
    tip[:] = 0.0
    still[:] = 0.0
    for j in range(qd.shape[0]):
        field_wrench(k.sum[j + 1], w, wrench)
        out.P[i] += qd[j] * dot6(k.S[j], wrench)
        for c in range(6):
            tip[c] += k.S[j, c] * qd[j]
    if at.base >= 0:
        own = out.J_P[i, at.base : at.base + 10]
        field_base(k, w, nu, row, own)
        own *= -1.0
    if at.target >= 0:
        own = out.J_P[i, at.target : at.target + 10]
        field_tool(k, w, nu, tip, row, own)
        own *= -1.0
