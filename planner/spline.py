"""Rest-to-rest joint trajectories: clamped uniform B-splines of degree five, continuous jerk.

The first four control points are equal, and so are the last four, so speed, acceleration and jerk
are zero at both ends. A closed trajectory ends where it starts and can be repeated without a break.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.interpolate import BSpline

from fsw.config.text import RECORDING, kind_of
from fsw.errors import ConfigError
from fsw.messages import FloatArray
from planner.firings import Firing

DEGREE = 5
REST_POINTS = 4
DERIVATIVES = 4  # position, velocity, acceleration, jerk


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectory:
    """A joint motion over [0, duration_s]; the arm rests before and after it."""

    duration_s: float
    points_rad: FloatArray  # (k, n) control points
    firings: tuple[Firing, ...] = ()

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.points_rad.shape[1])

    def evaluate(self, t_s: FloatArray) -> list[FloatArray]:
        """Return q, qd, qdd, qddd at times (m,), each (m, n) [rad or m, s]."""
        W = basis(self.duration_s, len(self.points_rad), tuple(t_s.tolist()))
        return [W[d] @ self.points_rad for d in range(DERIVATIVES)]

    def scaled(self, factor: float) -> Trajectory:
        """Return the motion with all excursions from its start pose multiplied by `factor`."""
        start = self.points_rad[0]
        return Trajectory(
            duration_s=self.duration_s,
            points_rad=start + factor * (self.points_rad - start),
            firings=self.firings,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SplineLayout:
    """Maps the variables z (rows, n) of the solver to the control points of a trajectory.

    Row 0 of z is the start pose and the last row is the end pose [rad or m]. A closed trajectory
    ends at its start and has no row for its end.
    """

    duration_s: float
    intervals: int
    n: int
    closed: bool

    @property
    def points(self) -> int:
        """Number of control points."""
        return self.intervals + DEGREE

    @property
    def rows(self) -> int:
        """Number of free control points."""
        return self.points - 2 * REST_POINTS + (1 if self.closed else 2)

    def selection(self) -> FloatArray:
        """Return E (points, rows): control points = E z."""
        E = np.zeros((self.points, self.rows))
        E[:REST_POINTS, 0] = 1.0
        inner = self.points - 2 * REST_POINTS
        E[REST_POINTS : REST_POINTS + inner, 1 : 1 + inner] = np.eye(inner)
        E[-REST_POINTS:, 0 if self.closed else -1] = 1.0
        return E

    def weights(self, t_s: FloatArray) -> FloatArray:
        """Return (4, m, rows): element d times z is derivative d of q at the times (m,) [s]."""
        weights: FloatArray = basis(self.duration_s, self.points, tuple(t_s.tolist()))
        return np.asarray(weights @ self.selection())

    def trajectory(self, z: FloatArray) -> Trajectory:
        """Return the trajectory of the variables z, given as (rows, n) or flat."""
        points = self.selection() @ z.reshape(self.rows, self.n)
        return Trajectory(duration_s=self.duration_s, points_rad=points)


@lru_cache(maxsize=8)
def basis(duration_s: float, points: int, t_s: tuple[float, ...]) -> FloatArray:
    """Return the basis functions and their three derivatives at times t_s, (4, m, points)."""
    inner = np.linspace(0.0, duration_s, points - DEGREE + 1)
    knots = np.concatenate([np.zeros(DEGREE), inner, np.full(DEGREE, duration_s)])
    curve = BSpline(knots, np.eye(points), DEGREE)
    times = np.clip(np.array(t_s), 0.0, duration_s)
    stacked: FloatArray = np.stack([curve.derivative(d)(times) for d in range(DERIVATIVES)])
    stacked.setflags(write=False)
    return stacked


def load(path: Path) -> Trajectory:
    """Read a trajectory file (YAML: degree, duration_s, control_points_rad, firings).

    Raises
    ------
    ConfigError that names the fault in the file.
    """
    try:
        source = path.read_bytes()
        document = None if kind_of(source) == RECORDING else yaml.safe_load(source)
    except (OSError, yaml.YAMLError) as error:
        words = " ".join(str(error).split())
        raise ConfigError(f"{path}: cannot be read: {words}") from error
    if not isinstance(document, dict) or document.get("degree") != DEGREE:
        kind = f"; it is {kind}" if (kind := kind_of(source)) else ""
        raise ConfigError(f"{path}: must be a joint trajectory with degree: {DEGREE}{kind}")
    try:
        firings = tuple(Firing.model_validate(firing) for firing in document.get("firings") or ())
        duration_s = float(document["duration_s"])
        points = np.array(document["control_points_rad"], dtype=np.float64)
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: duration_s, control_points_rad or firings: {error}") from error
    if points.ndim != 2 or len(points) < 2 * REST_POINTS or not np.isfinite(points).all():
        raise ConfigError(
            f"{path}: control_points_rad must be (k, n) finite numbers, "
            f"k at least {2 * REST_POINTS}; found shape {points.shape}"
        )
    ends = (points[:REST_POINTS], points[-REST_POINTS:])
    if not duration_s > 0 or any(np.any(end != end[0]) for end in ends):
        raise ConfigError(
            f"{path}: duration_s must be positive, and the first and last {REST_POINTS} control "
            "points equal (rest to rest)"
        )
    return Trajectory(duration_s=duration_s, points_rad=points, firings=firings)


def save(trajectory: Trajectory, path: Path, about: dict[str, Any]) -> None:
    """Write a trajectory file; `about` is stored in it and describes its origin."""
    document = {
        "about": about,
        "degree": DEGREE,
        "duration_s": float(trajectory.duration_s),
        "control_points_rad": [[float(x) for x in row] for row in trajectory.points_rad],
    }
    if trajectory.firings:
        document["firings"] = [firing.model_dump() for firing in trajectory.firings]
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=100)
    path.write_text(text, encoding="utf-8")
