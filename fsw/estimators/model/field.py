"""Wrench of a linear field of acceleration, as that of the gravity gradient, on a body."""

from functools import lru_cache

import numpy as np

from fsw.estimators.model.inertia import PARAMETERS, parameter_basis
from fsw.messages import FloatArray


@lru_cache(maxsize=1)
def _field_wrench_by_field() -> FloatArray:
    """Return (60, 9): force and moment about the origin, by parameter, of each element of G."""
    W = np.zeros((9, 6, PARAMETERS))
    for k, G in enumerate(np.eye(9).reshape(9, 3, 3)):
        W[k, :3, 1:4] = G
        M = G @ parameter_basis()[:, :3, :3]
        W[k, 3], W[k, 4], W[k, 5] = (M[:, j, i] - M[:, i, j] for i, j in ((1, 2), (2, 0), (0, 1)))
    return W.reshape(9, -1).T


def field_wrenches(G: FloatArray) -> FloatArray:
    """Return W (N, 6, 10): W pi is force and moment about the origin of the field G s on a body."""
    W: FloatArray = G.reshape(-1, 9) @ _field_wrench_by_field().T
    return W.reshape(-1, 6, PARAMETERS)
