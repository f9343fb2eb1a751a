"""Thrusters of the true robot: jets on the base, their firings, and the delay of the force."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Jet:
    """One thruster, fixed in the base."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    place_m: tuple[float, float, float]  # point where the force acts, base frame
    direction: tuple[float, float, float]  # direction of the force, any length
    force_n: float

    @property
    def unit(self) -> FloatArray:
        """Return the direction (3,) with length 1."""
        direction = np.array(self.direction, dtype=np.float64)
        return np.asarray(direction / np.linalg.norm(direction))


@dataclass(frozen=True, slots=True, kw_only=True)
class Pulse:
    """One firing: a valve is open for `for_s` from `on_s` after the motion's start."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    jet: int  # index of the jet, from 0
    on_s: float
    for_s: float
    reported: bool = True  # the valve's node reports it on the bus


@dataclass(frozen=True, kw_only=True)
class ThrusterSystem:
    """The jets, their valves and the firings.

    The force follows its valve after `delay_s` as a first-order lag of time constant `rise_s`.
    Joints do not give way to a firing: the brakes are closed or the control is stiff.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")
    jets: tuple[Jet, ...]
    pulses: tuple[Pulse, ...]
    delay_s: float = 0.005
    rise_s: float = 0.01
    # 1 sigma of the errors of configured forces, delays and rise times; half the variance of the
    # force errors is common to all jets
    force_sigma_ratio: float = 0.03
    delay_sigma_s: float = 0.001
    rise_sigma_s: float = 0.001

    @cached_property
    def ways(self) -> FloatArray:
        """Return each jet's full force [N] and moment about the base origin [N m], (6, K) in B."""
        force = np.array([jet.force_n * jet.unit for jet in self.jets])
        moment = np.cross(np.array([jet.place_m for jet in self.jets]), force)
        return np.concatenate([force, moment], axis=1).T

    @cached_property
    def _edges(self) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
        """Return jet, time [s] and sign (1 opens, -1 closes) of every change of a valve."""
        owner = np.array([pulse.jet for pulse in self.pulses for _ in range(2)], np.intp)
        at_s = np.array([t for p in self.pulses for t in (p.on_s, p.on_s + p.for_s)], np.float64)
        return owner, at_s, np.tile([1.0, -1.0], len(self.pulses))

    def wrench(self, t_s: float) -> FloatArray:
        """Return force [N] and moment about the base's origin [N m] (6,) in base axes."""
        return np.asarray(self.ways @ self.shares(t_s))

    def shares(self, t_s: float) -> FloatArray:
        """Return each jet's share (K,) of its full force."""
        owner, at_s, sign = self._edges
        since = np.maximum(t_s - at_s - self.delay_s, 0.0)
        share = np.zeros(len(self.jets))
        np.add.at(share, owner, sign * (1.0 - np.exp(-since / self.rise_s)))
        return share

    def valves_at(self, t_s: float) -> tuple[list[bool], float | None, int]:
        """Return the open valves, age [s] of the last change (None: no change) and change count."""
        own = [pulse for pulse in self.pulses if pulse.reported]
        times = {t for p in own for t in (p.on_s, p.on_s + p.for_s) if t <= t_s}
        opened = {p.jet for p in own if p.on_s <= t_s < p.on_s + p.for_s}
        age_s = t_s - max(times) if times else None
        return [k in opened for k in range(len(self.jets))], age_s, len(times)
