"""Laboratory stands of the base, a bench or an air-bearing table, and gravity on them."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stand:
    """The base on a bench (clamped) or a level table (planar); B starts parallel to N."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    motion: Literal["planar", "clamped"]
    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, -9.80665)

    @property
    def freedom(self) -> FloatArray:
        """Return the base's free directions [v, w] (6, k): x, y and rotation about z, or none."""
        return np.eye(6)[:, [0, 1, 5]] if self.motion == "planar" else np.zeros((6, 0))

    def give(self, H_bb: FloatArray, force: FloatArray) -> FloatArray:
        """Return the accelerations [v; w] (6,) or (6, k) of a base with inertia H_bb (6, 6).

        `force` (6,) or (6, k) acts on it in the same order; a held direction has zero.
        """
        S = self.freedom
        return np.asarray(S @ np.linalg.solve(S.T @ H_bb @ S, S.T @ force))

    def at(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return gravity (k, 3) [m/s^2] and its gradient (k, 3, 3), in N."""
        count = len(np.atleast_1d(t_s))
        return np.tile(self.gravity_m_s2, (count, 1)), np.zeros((count, 3, 3))
