"""Friction of joints at rest: an error of unknown sign that lasts as long as the standstill.

A joint at rest is held by any torque up to its Coulomb friction. That part of its reading is one
and the same error in every window of the standstill, so only the first window tells of the torque.
"""

import numpy as np
from numpy.typing import NDArray

from fsw.messages import FloatArray

CREPT_RAD = 1e-4  # a joint that moves by less between two windows is still at rest (rad or m)
LASTING = 100.0  # factor on friction's sigma in later windows: 10^4 of them count as one more


class Standstills:
    """Finds the joints whose standstill began in an earlier window."""

    def __init__(self, sigma_rad: FloatArray) -> None:
        """`sigma_rad` (n,): noise of a position."""
        self._near_rad = CREPT_RAD + 5.0 * sigma_rad
        self._at_rad = np.full(len(sigma_rad), np.nan)

    def factor(self, q_rad: FloatArray, is_resting: NDArray[np.bool_]) -> FloatArray:
        """Return the factor (n,) on friction's sigma in the next window.

        Parameters
        ----------
        q_rad, is_resting : (n,) angle in the window, and whether the joint rests all through it
        """
        lasts = is_resting & (np.abs(q_rad - self._at_rad) <= self._near_rad)
        self._at_rad = np.where(is_resting, np.where(lasts, self._at_rad, q_rad), np.nan)
        return np.where(lasts, LASTING, 1.0)
