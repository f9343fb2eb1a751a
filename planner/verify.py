"""The dense check: every limit on a dense grid, for all members of the prior set."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fsw.messages import FloatArray
from planner.collision import Collisions
from planner.design import DesignRows, Grid, LimitRows
from planner.limits import MotionLimits
from planner.spline import DEGREE, REST_POINTS, SplineLayout, Trajectory
from planner.subject import Subject

SHARE_MARGIN = 0.002  # share of every bound that a passing motion leaves free
SQUARE = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Use:
    """How close a motion comes to one limit, at the worst sample of the worst member."""

    kind: str
    value: float
    bound: float
    unit: str
    time_s: float
    excess: float  # as a share of the bound (metres for distances); positive beyond the bound
    member: int  # index in the prior set; 0: the nominal bodies

    def text(self) -> str:
        """Return one line: the limit, the value, its distance to the bound, and the time."""
        side = "beyond" if self.excess > 0 else "inside"
        member = f", body {self.member} of the prior set" if self.member else ""
        return (
            f"{self.kind}: {self.value:.5g} {self.unit}, {abs(self.value - self.bound):.3g} {side} "
            f"the bound {self.bound:.5g}, at {self.time_s:.2f} s{member}"
        )


def every_limit(
    subject: Subject,
    limits: MotionLimits,
    collisions: Collisions | None,
    trajectory: Trajectory,
    rate_hz: float,
    members: Sequence[FloatArray],
) -> list[Use]:
    """Return the worst use of every limit over all members, the largest excess first."""
    layout, z = free_layout(trajectory)
    grid = Grid(layout, rate_hz)
    worst: dict[str, Use] = {}
    for k, x in enumerate(members):
        rows = LimitRows(subject, grid, limits, collisions if k == 0 else None)
        for row in rows.rows(z, [x]):
            use = _worst(row, grid.t_s, k)
            if row.kind not in worst or use.excess > worst[row.kind].excess:
                worst[row.kind] = use
    return sorted(worst.values(), key=lambda use: -use.excess)


def free_layout(trajectory: Trajectory) -> tuple[SplineLayout, FloatArray]:
    """Return a trajectory's layout with both ends free, and its flat variables z (rows n,)."""
    points = trajectory.points_rad
    layout = SplineLayout(
        duration_s=trajectory.duration_s,
        intervals=len(points) - DEGREE,
        n=trajectory.n,
        closed=False,
    )
    inner = points[REST_POINTS - 1 : len(points) - REST_POINTS + 1]
    return layout, np.asarray(inner.ravel())


def _worst(row: DesignRows, t_s: FloatArray, member: int) -> Use:
    value = np.sqrt(row.value) if row.power == SQUARE else row.value
    below, above = row.lower - value, value - row.upper
    excess = np.maximum(below, above)
    k = int(excess.argmax())
    bound = row.lower[k] if below[k] > above[k] else row.upper[k]
    return Use(
        kind=row.kind,
        value=float(value[k] * row.size),
        bound=float(bound * row.size),
        unit=row.unit,
        time_s=float(t_s[k]),
        excess=float(excess[k]),
        member=member,
    )
