"""Noise that fades exponentially, and its covariance at the nodes of a window.

The noise is a first-order autoregression (Box, Jenkins, Time Series Analysis, 1976, sec. 3.2). The
polynomial fit of a window maps it from the samples to the nodes.
"""

from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import matmul_toeplitz

from fsw.estimators.conditioning.polynomial import gauss_nodes
from fsw.messages import FloatArray

NEIGHBOURS = 4  # windows on either side whose nodes are correlated with those of this window


def instants(samples: int) -> FloatArray:
    """Return the instants (samples,) of a window's samples, scaled to (-1, 1)."""
    return np.asarray((np.arange(samples) + 0.5) * (2.0 / samples) - 1.0, np.float64)


@lru_cache(maxsize=8)
def _to_nodes(samples: int, nodes: int) -> FloatArray:
    """Return (2 nodes, samples): map of samples to values, then derivatives, at the nodes.

    Derivatives are by the time in half windows.
    """
    Q, R = np.linalg.qr(legendre.legvander(instants(samples), nodes - 1))
    unit = np.eye(nodes)
    at_nodes = [
        legendre.legval(gauss_nodes(nodes), legendre.legder(unit, order)).T for order in (0, 1)
    ]
    return np.asarray(np.concatenate(at_nodes) @ np.linalg.solve(R, Q.T), np.float64)


def covariance_at_nodes(
    samples: int, nodes: int, fading: float, *, derivatives: bool = False
) -> FloatArray:
    """Return the covariance (m, m) at the nodes of noise of unit variance.

    With `derivatives` (2 m, 2 m): of values, then of derivatives by the time in half windows.

    The covariance with the nodes of neighbouring windows is included, so that all windows together
    determine a constant as accurately as their samples do.

    Parameters
    ----------
    fading : correlation from one sample to the next, 0 to below 1
    """
    E, place = _to_nodes(samples, nodes), np.arange(samples)
    E = E if derivatives else E[:nodes]
    # samples i, j of two successive windows correlate by a^(samples + i - j), a product of two
    further = sum(fading ** (samples * k) for k in range(NEIGHBOURS))
    across = further * np.outer(E @ fading**place, E @ fading ** (samples - place))
    return np.asarray(E @ matmul_toeplitz(fading**place, E.T) + across + across.T)
