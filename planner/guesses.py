"""Start motions: random ones that keep the limits, and the feasible one nearest to a motion."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import minimize

from fsw.messages import FloatArray
from planner.design import LimitRows
from planner.limits import MotionLimits
from planner.spline import SplineLayout

FIRST_MARGIN = 0.01  # first margin of limits other than torque, share of the bound (distances: m)
START_RANGE = 0.6  # share of a joint's range for random start poses
START_TRIES = 200
FREE_M = 1.0  # assumed range to either side of a prismatic joint without a range


class Guesses:
    """Finds start motions, as flat variables z, that keep the limits on the optimiser's grid.

    Parameters
    ----------
    members : parameter vectors of the prior set, (p,) each
    fixed : values of fixed variables, by index in z
    """

    def __init__(
        self,
        limits: MotionLimits,
        layout: SplineLayout,
        rows: LimitRows,
        members: Sequence[FloatArray],
        fixed: Mapping[int, float],
    ) -> None:
        self.limits, self.layout, self.rows = limits, layout, rows
        self.members, self.fixed = members, fixed

    def random_feasible(self, rng: np.random.Generator) -> FloatArray | None:
        """Return a random motion with its amplitude bisected up to the first active limit.

        The planner shrinks it further, so that it passes the dense check as well.

        Return None when no motionless start pose keeps the limits, or when an end pose is given.
        """
        if self.limits.end_rad is not None:
            return None
        for _ in range(START_TRIES):
            start = self._pose(rng)
            rest = np.tile(start, (self.layout.rows, 1))
            if self.feasible(rest.ravel()):
                break
            if self.limits.start_rad is not None:
                return None
        else:
            return None
        direction = rng.uniform(-1.0, 1.0, rest.shape)
        direction[0] = 0.0
        low, high = 0.0, 1.0
        for _ in range(12):
            middle = 0.5 * (low + high)
            if self.feasible((rest + middle * direction).ravel()):
                low = middle
            else:
                high = middle
        return np.asarray((rest + low * direction).ravel())

    def feasible(self, z: FloatArray) -> bool:
        """Return whether all limits hold on the optimiser's grid for every member."""
        rows = self.rows.rows(z, self.members)
        return all(bool(np.all(r.value <= r.upper) and np.all(r.value >= r.lower)) for r in rows)

    def nearest_feasible(self, z: FloatArray, in_set: Sequence[int] = (0,)) -> FloatArray:
        """Return a motion near z that locally minimises the sum of squared violations.

        `in_set`: indices of the members for which the limits count.
        """
        members = [self.members[k] for k in in_set]
        free = np.array([k for k in range(z.size) if k not in self.fixed])

        def violation(part: FloatArray) -> tuple[float, FloatArray]:
            whole = z.copy()
            whole[free] = part
            total, gradient = 0.0, np.zeros(z.size)
            for row in self.rows.rows(whole, members, derivatives=True):
                above = np.maximum(row.value - row.upper + FIRST_MARGIN, 0.0)
                below = np.maximum(row.lower - row.value + FIRST_MARGIN, 0.0)
                total += float(above @ above + below @ below)
                if row.by_z is not None:
                    gradient += 2 * (above - below) @ row.by_z
            return total, gradient[free]

        found = minimize(violation, z[free], jac=True, method="L-BFGS-B", options={"maxiter": 150})
        nearest = z.copy()
        nearest[free] = found.x
        return nearest

    def random_motion(self, rng: np.random.Generator) -> FloatArray:
        """Return a smooth motion from start to end pose, or without end pose a small random one."""
        start = self._pose(rng)
        if self.limits.end_rad is None:
            points = start + 0.05 * rng.uniform(-1.0, 1.0, (self.layout.rows, self.layout.n))
            points[0] = start
            return np.asarray(points.ravel())
        share = np.linspace(0.0, 1.0, self.layout.rows)[:, None]
        share = share**3 * (10 - 15 * share + 6 * share**2)
        way = start + share * (np.array(self.limits.end_rad) - start)
        way[1:-1] += 0.02 * rng.uniform(-1.0, 1.0, way[1:-1].shape)
        return np.asarray(way.ravel())

    def _pose(self, rng: np.random.Generator) -> FloatArray:
        if self.limits.start_rad is not None:
            return np.array(self.limits.start_rad)
        low, high = self.rows.joints.lower_rad, self.rows.joints.upper_rad
        free = np.where(np.array(self.rows.joints.units) == "m", FREE_M, np.pi)
        low = np.where(np.isfinite(low), low, -free)
        high = np.where(np.isfinite(high), high, free)
        reach = START_RANGE * rng.uniform(-1.0, 1.0, len(low))
        return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * reach)
