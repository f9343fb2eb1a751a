"""Sudden motion: what controllers, brakes and people make of a planned motion.

Each kind wraps a motion: it delays the motion's own time, or adds to it. Accelerations stay
continuous, as those of a real arm do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field

from hil.world.spline import Evaluated, Motion

FloatArray = NDArray[np.float64]
Positive = Annotated[float, Field(gt=0)]


class _Kind(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    def longer_s(self) -> float:
        """Return by how much longer the motion lasts [s]."""
        return 0.0

    def own_time(self, t_s: FloatArray) -> Evaluated:
        """Return the time in the planned motion and its two derivatives."""
        return t_s, np.ones_like(t_s), np.zeros_like(t_s)

    def added(self, t_s: FloatArray) -> Evaluated:
        """Return what is added to each joint, in rad or m, and its two derivatives."""
        return np.zeros_like(t_s), np.zeros_like(t_s), np.zeros_like(t_s)


class Stop(_Kind):
    """An emergency stop: brakes hold the arm within `in_s`; then the motion continues."""

    kind: Literal["stop"] = "stop"
    at_s: Positive
    in_s: Positive = 0.1
    for_s: Positive = 2.0

    def longer_s(self) -> float:
        """Return the time of the stop."""
        return self.for_s + self.in_s

    def own_time(self, t_s: FloatArray) -> Evaluated:
        """Return time in the planned motion and two derivatives; it stands still in the stop."""
        down = np.clip((t_s - self.at_s) / self.in_s, 0.0, 1.0)
        up = np.clip((t_s - self.at_s - self.in_s - self.for_s) / self.in_s, 0.0, 1.0)
        lost, slower, harder = (a - b for a, b in zip(_step(down), _step(up), strict=True))
        # after the ramp the lost time grows as fast as time
        after = np.clip(t_s - self.at_s - self.in_s, 0.0, None)
        again = np.clip(t_s - self.at_s - 2 * self.in_s - self.for_s, 0.0, None)
        return (
            t_s - self.in_s * lost - after + again,
            1.0 - slower,
            -harder / self.in_s,
        )


class Steps(_Kind):
    """A joint that moves in steps: it comes to rest every `period_s`."""

    kind: Literal["steps"] = "steps"
    period_s: Positive = 0.5

    def own_time(self, t_s: FloatArray) -> Evaluated:
        """Return the time in the planned motion, which stands still once a period; derivatives."""
        rate = 2.0 * np.pi / self.period_s
        return (
            t_s - np.sin(rate * t_s) / rate,
            1.0 - np.cos(rate * t_s),
            rate * np.sin(rate * t_s),
        )


class Chatter(_Kind):
    """A controller that chatters: every joint swings about its planned motion."""

    kind: Literal["chatter"] = "chatter"
    size_rad: Positive = 1e-4
    rate_hz: Positive = 20.0
    from_s: Positive = 10.0
    to_s: Positive = 50.0

    def added(self, t_s: FloatArray) -> Evaluated:
        """Return a sine that rises and falls within 0.2 s."""
        rate = 2.0 * np.pi * self.rate_hz
        up, down = ((t_s - edge) / 0.2 for edge in (self.from_s, self.to_s))
        rise, fall = (_rise(np.clip(part, 0.0, 1.0)) for part in (up, down))
        e, e1, e2 = (a - b for a, b in zip(rise, fall, strict=True))
        e1, e2 = e1 / 0.2, e2 / 0.2**2
        s, c = self.size_rad * np.sin(rate * t_s), self.size_rad * rate * np.cos(rate * t_s)
        return e * s, e1 * s + e * c, e2 * s + 2.0 * e1 * c - e * rate**2 * s


Sudden = Annotated[Stop | Steps | Chatter, Field(discriminator="kind")]


@dataclass(frozen=True, slots=True)
class SuddenMotion:
    """A planned motion with something sudden in it."""

    planned: Motion
    sudden: Sudden

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.planned.n

    @property
    def duration_s(self) -> float:
        """Length of the motion [s]."""
        return self.planned.duration_s + self.sudden.longer_s()

    def evaluate(self, t_s: ArrayLike) -> Evaluated:
        """Return positions, velocities, accelerations (..., n) at times [s]."""
        t = np.asarray(t_s, np.float64)
        s, s1, s2 = (part[..., None] for part in self.sudden.own_time(t))
        more, more1, more2 = (part[..., None] for part in self.sudden.added(t))
        q, qd, qdd = self.planned.evaluate(s[..., 0])
        return q + more, qd * s1 + more1, qdd * s1**2 + qd * s2 + more2


def _rise(u: FloatArray) -> Evaluated:
    """Return a smooth rise from 0 to 1 over u in [0, 1], and its two derivatives."""
    return (
        u**3 * (10.0 - 15.0 * u + 6.0 * u**2),
        30.0 * u**2 * (1.0 - u) ** 2,
        60.0 * u * (1.0 - u) * (1.0 - 2.0 * u),
    )


def _step(u: FloatArray) -> Evaluated:
    """Return the integral of `_rise`, the rise and its derivative."""
    rise, slope, _ = _rise(u)
    return u**4 * (2.5 - 3.0 * u + u**2), rise, slope
