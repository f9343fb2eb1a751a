"""Compiled small linear algebra on the rows of one sample."""

from __future__ import annotations

import numpy as np

from fsw.estimators.spatial import compiled, routine
from fsw.messages import FloatArray


@routine
def factor(S: FloatArray, m: int) -> bool:
    """Replace the lower triangle of S[:m, :m] by its Cholesky factor; False if not positive."""
    for i in range(m):
        for j in range(i + 1):
            total = S[i, j]
            for c in range(j):
                total -= S[i, c] * S[j, c]
            if i == j:
                if not total > 0.0:
                    return False
                S[i, i] = np.sqrt(total)
            else:
                S[i, j] = total / S[j, j]
    return True


@routine
def solve_both(L: FloatArray, z: FloatArray, m: int) -> None:
    """Replace z (m,) by (L L^T)^-1 z."""
    for i in range(m):
        total = z[i]
        for c in range(i):
            total -= L[i, c] * z[c]
        z[i] = total / L[i, i]
    for i in range(m - 1, -1, -1):
        total = z[i]
        for c in range(i + 1, m):
            total -= L[c, i] * z[c]
        z[i] = total / L[i, i]


@routine
def divide_rows(variances: FloatArray, rows: FloatArray) -> None:
    """Divide each row by the sigma of its own output, in place."""
    for i in range(rows.shape[0]):
        scale = 1.0 / np.sqrt(variances[i])
        for k in range(rows.shape[1]):
            rows[i, k] *= scale


@compiled
def gather(buffer: FloatArray, fill: int, gram: FloatArray) -> int:
    """Add a full buffer's rows to their Gram matrix; return how far it is filled then."""
    if fill == buffer.shape[0]:
        gram += np.dot(buffer.T, buffer)
        return 0
    return fill


@compiled
def gather_rest(buffer: FloatArray, fill: int, gram: FloatArray) -> None:
    """Add what a buffer that is not full holds."""
    if fill:
        buffer[fill:] = 0.0
        gram += np.dot(buffer.T, buffer)


@routine
def whiten(L: FloatArray, rows: FloatArray, m: int) -> None:
    """Replace rows[:m] by L^-1 rows, in place."""
    width = rows.shape[1]
    for i in range(m):
        for c in range(i):
            scale = L[i, c]
            if scale != 0.0:
                for k in range(width):
                    rows[i, k] -= scale * rows[c, k]
        scale = 1.0 / L[i, i]
        for k in range(width):
            rows[i, k] *= scale
