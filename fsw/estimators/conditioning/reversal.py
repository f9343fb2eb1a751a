"""Coulomb friction of a joint in one window: its shape, and how uncertain the shape is.

The torque of a block is the polynomial of its window, and friction at a reversal is no polynomial.
So its shape tanh(qd / v) goes through the same fit: the nodes' polynomial gives qd between the
nodes, and the window's least-squares polynomial of the shape is evaluated at the nodes. At low
rates it is not known how friction reverses, or whether it holds a joint at rest. The same fit of 1
- tanh^2 shows how much of a window is concerned.
"""

from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from fsw.estimators.conditioning.polynomial import EXTRA_DEGREE, gauss_nodes
from fsw.messages import FloatArray

DULLEST = 2.0  # times the configured rate: friction is uncertain at speeds up to about this
INSTANTS = 64  # in a window, at which the shape is evaluated


@lru_cache(maxsize=4)
def _operators(m: int) -> tuple[FloatArray, FloatArray]:
    """Return E (INSTANTS, m) from nodes to instants, and P (m, INSTANTS), the fit back to nodes."""
    instants = (2.0 * np.arange(INSTANTS) + 1.0) / INSTANTS - 1.0
    at_nodes = legendre.legvander(gauss_nodes(m), m - 1)
    within = legendre.legvander(instants, m - 1)
    E = np.asarray(np.linalg.solve(at_nodes.T, within.T).T, np.float64)
    P: FloatArray = at_nodes @ np.linalg.pinv(within)
    return E, P


def shape(qd_rad_s: FloatArray, speed_rad_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return tanh(qd / v) after the fit, and its derivative by the rate at the same node [s/rad].

    Both have the shape of `qd_rad_s`.

    Parameters
    ----------
    qd_rad_s : (..., m, n) rates of n joints at the m nodes of windows
    speed_rad_s : (n,) the rate v at which friction reverses
    """
    E, P = _operators(qd_rad_s.shape[-2])
    values = np.tanh((E @ qd_rad_s) / speed_rad_s)
    steep = (1.0 - values**2) / speed_rad_s
    slope = np.einsum("mk,...kn,km->...mn", P, steep, E)
    return P @ values, slope


@lru_cache(maxsize=4)
def _projector(m: int) -> FloatArray:
    """Return (INSTANTS, INSTANTS): what the polynomial leaves whose residuals are the noise."""
    E, _ = _operators(m)
    instants = (2.0 * np.arange(INSTANTS) + 1.0) / INSTANTS - 1.0
    V = legendre.legvander(instants, m - 1 + EXTRA_DEGREE)
    return np.asarray(np.eye(len(E)) - V @ np.linalg.pinv(V), np.float64)


def step(qd_rad_s: FloatArray, speed_rad_s: FloatArray) -> FloatArray:
    """Return the rms (n,) of what the window's polynomial leaves of tanh(qd / v).

    The conditioner counts it as noise. `qd_rad_s` is (m, n) at the nodes, `speed_rad_s` is v (n,).
    """
    m = len(qd_rad_s)
    left = _projector(m) @ np.tanh((_operators(m)[0] @ qd_rad_s) / speed_rad_s)
    return np.asarray(np.sqrt(np.mean(left**2, axis=0)), np.float64)


def doubt(qd_rad_s: FloatArray, speed_rad_s: FloatArray) -> FloatArray:
    """Return two possible errors of friction at the nodes (2, m, n), as shares of Coulomb friction.

    The first error has one sign on both sides of the reversal (friction reverses early or late, or
    the joint sticks). The second changes its sign there (friction reverses sharply or gradually).
    """
    E, P = _operators(qd_rad_s.shape[-2])
    odd = np.tanh((E @ qd_rad_s) / (DULLEST * speed_rad_s))
    even = 1.0 - odd**2
    return np.stack([P @ even, P @ (even * odd)])
