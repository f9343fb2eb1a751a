"""What noisy accelerations add to the normal equations of MRNEA, in closed form.

With P the covariance of all accelerations and W the rows' weight, the sum over the noise directions
of Y^T W Y is wanted, Y the bodies' columns at unit accelerations and no rates. Base and target feel
six accelerations each, K_b a and K_t a, the latter in the tool's axes; the same K map wrenches on
them to the rows, and the regressor Z of six unit accelerations is constant. So one sample gives the
Kronecker product of Q = K P K^T and V = K W K^T, and Z is applied once, after all samples.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fsw.estimators.kernel import Work
from fsw.estimators.methods.layout import Columns
from fsw.estimators.methods.linear import whiten
from fsw.estimators.projection import project
from fsw.estimators.spatial import compiled, inlined, routine
from fsw.messages import FloatArray


class Inflation(NamedTuple):
    """Scratch of one sample and the sums over all; base accelerations first, then the tool's."""

    Z: FloatArray  # (36, 10) row 6 k + i: component i of the wrench at unit acceleration k
    columns: FloatArray  # (m, 24) K^T, then H P0 K^T with P0 the measured accelerations' covariance
    Q: FloatArray  # (12, 12)
    V: FloatArray  # (12, 12)
    cross: FloatArray  # (12, 12) K P0 H^T W K^T
    sums: FloatArray  # (3, 36, 36) of Q x V: base and base, base and target, target and target


@compiled
def new_inflation(m: int) -> Inflation:
    """Return scratch and sums for m rows."""
    Z = np.zeros((36, 10))
    for k in range(6):
        move = np.zeros(9)
        move[k] = 1.0
        for i in range(6):
            u = np.zeros(6)
            u[i] = 1.0
            project(move, u[0], u[1], u[2], u[3], u[4], u[5], Z[6 * k + i])
    square = np.zeros((12, 12))
    return Inflation(
        Z, np.zeros((m, 24)), square, square.copy(), square.copy(), np.zeros((3, 36, 36))
    )


@routine
def add_sample(
    at: Columns, k: Work, H: FloatArray, sigma: FloatArray, L: FloatArray,
    weighted: bool, smoothed: bool, t: Inflation,
) -> None:  # fmt: skip
    """Add one sample's Q x V to the sums, and leave its cross term.

    Parameters: `H` (m, m) joint-space inertia; `sigma` (>= m,) of the accelerations; `L` the factor
    of the rows' covariance, used if `weighted`; `smoothed`: P is what is left after smoothing,
    P0 - P0 H^T W H P0, else P0.
    """
    m = t.columns.shape[0]
    _accelerations(k, t.columns)
    for c in range(m):
        out = t.columns[c]
        out[12:] = 0.0
        for b in range(m):
            scale = H[c, b] * sigma[b] ** 2
            for e in range(12):
                out[12 + e] += scale * t.columns[b, e]
    first, stop = 0 if at.base >= 0 else 6, 12 if at.target >= 0 else 6
    Q, V, cross = t.Q, t.V, t.cross
    Q[:], V[:], cross[:] = 0.0, 0.0, 0.0
    for c in range(m):
        _add_outer(sigma[c] ** 2, t.columns[c], 0, 0, first, stop, Q)
    if weighted:
        whiten(L, t.columns, m)
    for c in range(m):
        _add_outer(1.0, t.columns[c], 0, 0, first, stop, V)
        _add_outer(1.0, t.columns[c], 12, 0, first, stop, cross)
        if smoothed:
            _add_outer(-1.0, t.columns[c], 12, 12, first, stop, Q)
    if at.base >= 0:
        _add_product(Q, V, 0, 0, t.sums[0])
    if at.base >= 0 and at.target >= 0:
        _add_product(Q, V, 0, 6, t.sums[1])
    if at.target >= 0:
        _add_product(Q, V, 6, 6, t.sums[2])


@inlined
def _add_outer(
    scale: float, row: FloatArray, left: int, right: int, first: int, stop: int, out: FloatArray
) -> None:
    """Add the outer product of two twelves of a row to out (12, 12), from first to stop."""
    for a in range(first, stop):
        scaled = scale * row[left + a]
        for b in range(first, stop):
            out[a, b] += scaled * row[right + b]


@routine
def _accelerations(k: Work, columns: FloatArray) -> None:
    """Set the first twelve of every row to the two bodies' accelerations for one unit of its own.

    Rows: base acceleration (6,), joint accelerations (n,).
    """
    E = k.E
    for c in range(columns.shape[0]):
        out, u = columns[c], k.scratch[0]
        u[:] = 0.0
        out[:12] = 0.0
        if c < 6:
            u[c] = out[c] = 1.0
        else:
            for e in range(6):
                u[e] = k.S[c - 6, e]
        fx = u[0] + u[4] * E[3, 2] - u[5] * E[3, 1]
        fy = u[1] + u[5] * E[3, 0] - u[3] * E[3, 2]
        fz = u[2] + u[3] * E[3, 1] - u[4] * E[3, 0]
        for e in range(3):
            out[6 + e] = E[0, e] * fx + E[1, e] * fy + E[2, e] * fz
            out[9 + e] = E[0, e] * u[3] + E[1, e] * u[4] + E[2, e] * u[5]


@routine
def _add_product(Q: FloatArray, V: FloatArray, row: int, column: int, out: FloatArray) -> None:
    for k in range(6):
        for i in range(6):
            to = out[6 * k + i]
            for b in range(6):
                scale = Q[row + k, column + b]
                for j in range(6):
                    to[6 * b + j] += scale * V[row + i, column + j]


@routine
def shrinkage(at: Columns, t: Inflation, out: FloatArray) -> None:
    """Set out (p,) = sum over the noise of Y^T W H, of the sample last added."""
    out[:] = 0.0
    for body in range(2):
        first = at.target if body == 1 else at.base
        if first >= 0:
            for k in range(6):
                for i in range(6):
                    scale = t.cross[6 * body + k, 6 * body + i]
                    for e in range(10):
                        out[first + e] += scale * t.Z[6 * k + i, e]


@compiled
def inflation(at: Columns, t: Inflation, out: FloatArray) -> None:
    """Set out (p, p) = sum over samples and noise of Y^T W Y."""
    out[:] = 0.0
    Z, b, e = t.Z, at.base, at.target
    if b >= 0:
        out[b : b + 10, b : b + 10] = np.dot(np.dot(Z.T, t.sums[0]), Z)
    if e >= 0:
        out[e : e + 10, e : e + 10] = np.dot(np.dot(Z.T, t.sums[2]), Z)
    if b >= 0 and e >= 0:
        both = np.dot(np.dot(Z.T, t.sums[1]), Z)
        out[b : b + 10, e : e + 10] = both
        out[e : e + 10, b : b + 10] = both.T
