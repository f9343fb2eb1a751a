"""The prediction pass for rate and base velocity alone, several times faster (CM).

No torque is asked for, so the known bodies enter by their common inertia and momentum only, which
the motion fixes: they are computed once, and a pass places base and target among them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fsw.estimators.kernel import Arm, Work, configure, new_work, solve_base
from fsw.estimators.methods.layout import CHUNK, Channels, Columns, Data, Prediction
from fsw.estimators.methods.linear import divide_rows, gather, gather_rest
from fsw.estimators.methods.momentum_pass import external
from fsw.estimators.methods.prediction_pass import fill_jacobian, fill_residual, new_prediction
from fsw.estimators.spatial import (
    compiled,
    factor_base,
    inlined,
    momentum,
    place_inertia,
    set_inertia,
)
from fsw.messages import FloatArray


class Known(NamedTuple):
    """What the known bodies and the motion give, sample by sample, about the base origin."""

    J: FloatArray  # (N, 10) inertia of all known bodies
    P: FloatArray  # (N, 6) their momentum at a base at rest
    E: FloatArray  # (N, 4, 3) rotation of the tool frame, then its origin
    V: FloatArray  # (N, 6) velocity of the last link at a base at rest


@compiled
def known_pass(arm: Arm, bodies: FloatArray, data: Data) -> Known:
    """Return the known share; `bodies` (n+1, 10) with nothing in the unknowns' place."""
    N, n = data.q.shape
    k = new_work(n)
    known = Known(np.zeros((N, 10)), np.zeros((N, 6)), np.zeros((N, 4, 3)), np.zeros((N, 6)))
    for i in range(N):
        configure(arm, bodies, data.q[i], k)
        known.J[i] = k.sum[0]
        known.E[i] = k.E
        for j in range(n):
            for c in range(6):
                known.P[i, c] += k.H_bm[j, c] * data.qd[i, j]
                known.V[i, c] += k.S[j, c] * data.qd[i, j]
    return known


@compiled
def rate_pass(known: Known, x: FloatArray, at: Columns, data: Data, use: Channels) -> FloatArray:
    """Return the Gram (p+1, p+1) of the whitened rows [J | residual], as `prediction_pass` does.

    For gyro and velocity as the only channels, outside a gravity field.
    """
    n, p = data.q.shape[1], x.shape[0]
    m = 3 * use.gyro + 3 * use.velocity
    k, s = new_work(n), new_prediction(data, use, p, m)
    gram = np.zeros((p + 1, p + 1))
    buffer = np.zeros((CHUNK * m, p + 1))
    fill = 0
    for i in range(data.q.shape[0]):
        rows = buffer[fill : fill + m]
        rows[:] = 0.0
        _predict(known, x, at, data, i, k, s)
        fill_residual(x, at, data, use, i, s, rows, n, p)
        fill_jacobian(x, at, data, use, i, k, s, rows)
        divide_rows(s.fixed, rows)
        fill = gather(buffer, fill + m, gram)
    gather_rest(buffer, fill, gram)
    return gram


@inlined
def _predict(
    known: Known, x: FloatArray, at: Columns, data: Data, i: int, k: Work, s: Prediction
) -> None:
    """Fill k and s for sample i: base velocity, velocity of base and last link, their factor."""
    n = data.q.shape[1]
    whole, own, P, E = k.sum[0], k.own[0], k.scratch[0], known.E[i]
    for c in range(10):
        whole[c] = known.J[i, c]
    for c in range(6):
        s.g[c] = known.P[i, c]
    if at.base >= 0:
        set_inertia(x[at.base : at.base + 10], own)
        for c in range(10):
            whole[c] += own[c]
    if at.target >= 0:
        place_inertia(
            x[at.target : at.target + 10],
            E[0, 0], E[0, 1], E[0, 2], E[1, 0], E[1, 1], E[1, 2], E[2, 0], E[2, 1], E[2, 2],
            E[3, 0], E[3, 1], E[3, 2],
            own,
        )  # fmt: skip
        momentum(own, known.V[i], P)
        for c in range(10):
            whole[c] += own[c]
        for c in range(6):
            s.g[c] += P[c]
    factor_base(whole, k.base)
    for c in range(6):
        s.a[c] = -s.g[c]  # external() takes s.g for itself
    external(x, at, data, i, k, s)
    for c in range(3):
        s.a[3 + c] += s.L[c]
    solve_base(k, s.a, s.nu)
    for r in range(4):
        for c in range(3):
            k.E[r, c] = E[r, c]
    for c in range(6):
        k.V[0, c] = s.nu[c] if c >= 3 else 0.0
    # as a base turning at nu carries the last link: v_b is left out (see fsw.estimators.kernel)
    for c in range(6):
        k.V[n, c] = known.V[i, c] + k.V[0, c]
