"""Rest-to-rest joint trajectories: clamped degree-5 B-splines with continuous jerk."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline

FloatArray = NDArray[np.float64]
Evaluated = tuple[FloatArray, FloatArray, FloatArray]  # a function's value and two derivatives

DEGREE = 5
REST_POINTS = 4  # equal control points at either end: zero speed, acceleration and jerk there


class Motion(Protocol):
    """A motion from rest to rest."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def duration_s(self) -> float:
        """Length of the motion [s]."""

    def evaluate(self, t_s: ArrayLike) -> Evaluated:
        """Return positions, velocities, accelerations (..., n) at times [s]."""


@dataclass(frozen=True, eq=False)
class JointSpline:
    """A joint motion over [0, duration_s]; before and after it the arm is at rest.

    Parameters
    ----------
    duration_s : length of the motion [s]
    control_points_rad : (k, n) control points on uniform clamped knots; the first and the last
        four rows must each be equal, so that the motion starts and ends at rest
    """

    duration_s: float
    control_points_rad: FloatArray

    def __post_init__(self) -> None:
        points = np.array(self.control_points_rad, dtype=np.float64)
        if points.ndim != 2 or len(points) < 2 * REST_POINTS:
            raise ValueError(
                f"control_points_rad has shape {points.shape}; "
                f"must be (k, n) with k at least {2 * REST_POINTS}"
            )
        if not self.duration_s > 0 or not np.isfinite(points).all():
            raise ValueError(
                f"duration_s {self.duration_s} must be positive and every control point finite"
            )
        for end in (points[:REST_POINTS], points[-REST_POINTS:]):
            if np.any(end != end[0]):
                raise ValueError(
                    f"the first and last {REST_POINTS} control points must be equal (rest to rest)"
                )
        points.setflags(write=False)
        object.__setattr__(self, "control_points_rad", points)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.control_points_rad.shape[1])

    @property
    def knot_spacing_s(self) -> float:
        """Time between neighbouring knots [s]."""
        return self.duration_s / (len(self.control_points_rad) - DEGREE)

    @cached_property
    def _curves(self) -> tuple[BSpline, BSpline, BSpline]:
        inner = np.linspace(0.0, self.duration_s, len(self.control_points_rad) - DEGREE + 1)
        knots = np.concatenate([np.zeros(DEGREE), inner, np.full(DEGREE, self.duration_s)])
        position = BSpline(knots, self.control_points_rad, DEGREE)
        return position, position.derivative(1), position.derivative(2)

    def evaluate(self, t_s: ArrayLike) -> Evaluated:
        """Return joint positions [rad], velocities [rad/s] and accelerations [rad/s^2].

        Parameters
        ----------
        t_s : scalar or array of times; outside [0, duration_s] the arm rests

        Returns
        -------
        q, qd, qdd, each of shape t_s.shape + (n,)
        """
        t = np.asarray(t_s, dtype=np.float64)
        inside = np.clip(t, 0.0, self.duration_s)
        position, velocity, acceleration = self._curves
        moving = ((t > 0.0) & (t < self.duration_s))[..., None]
        return (
            np.asarray(position(inside), dtype=np.float64),
            np.where(moving, velocity(inside), 0.0),
            np.where(moving, acceleration(inside), 0.0),
        )

    def scaled(self, factor: float) -> JointSpline:
        """Return the same motion about its start pose with all excursions times `factor`."""
        start = self.control_points_rad[0]
        return JointSpline(self.duration_s, start + factor * (self.control_points_rad - start))

    def save(self, path: Path, about: dict[str, Any] | None = None) -> None:
        """Write the spline as YAML; `about` says how it was made."""
        document = {
            "about": about or {},
            "degree": DEGREE,
            "duration_s": float(self.duration_s),
            "control_points_rad": [[float(x) for x in row] for row in self.control_points_rad],
        }
        text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=100)
        path.write_text(text, encoding="utf-8")

    @staticmethod
    def load(path: Path) -> JointSpline:
        """Read a spline written by `save`.

        Raises
        ------
        ValueError if the file is not a spline of this degree or does not start and end at rest.
        """
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
        if not isinstance(document, dict) or document.get("degree") != DEGREE:
            raise ValueError(f"{path}: not a joint trajectory of degree {DEGREE}")
        missing = {"duration_s", "control_points_rad"} - document.keys()
        if missing:
            raise ValueError(f"{path}: missing {sorted(missing)}")
        points = np.array(document["control_points_rad"], dtype=np.float64)
        return JointSpline(float(document["duration_s"]), points)
