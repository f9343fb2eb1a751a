"""Reaction wheels of the true robot: rotors on the base, and their attitude control law."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

from hil.world.inertia import pi_of, six_of

FloatArray = NDArray[np.float64]
TAPER_RATIO = 0.05  # of the speed limit: range below it in which the torque falls to zero


@dataclass(frozen=True, slots=True, kw_only=True)
class Rotor:
    """One wheel, symmetric about its axis; the base's data include the wheel, locked."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    mass_kg: float
    place_m: tuple[float, float, float]  # centre of the wheel, base frame
    axis: tuple[float, float, float]  # any length
    inertia_kg_m2: float  # about the axis
    across_kg_m2: float  # about any axis perpendicular to it
    speed_rad_s: float = 0.0  # at the start, relative to the base

    @property
    def unit(self) -> FloatArray:
        """Return the wheel's axis (3,) with length 1."""
        axis = np.array(self.axis, dtype=np.float64)
        return np.asarray(axis / np.linalg.norm(axis))

    @property
    def report(self) -> FloatArray:
        """Return the wheel's report (10,): mass, centre, inertia about the centre, base axes."""
        a = self.unit
        tensor = self.across_kg_m2 * np.eye(3)
        tensor += (self.inertia_kg_m2 - self.across_kg_m2) * np.outer(a, a)
        return np.array([self.mass_kg, *self.place_m, *six_of(tensor)])

    @property
    def pi(self) -> FloatArray:
        """Return the wheel's parameters pi (10,) in the base frame (see `hil.world.inertia`)."""
        return pi_of(self.report)


@dataclass(frozen=True, kw_only=True)
class WheelSystem:
    """The wheels and their attitude hold: a PD law on attitude and rate of the base."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    rotors: tuple[Rotor, ...]
    torque_limit_nm: float
    speed_limit_rad_s: float
    stiffness_nm_rad: float  # of the attitude hold; both gains 0: wheels coast
    damping_nms_rad: float
    inertia_sigma_ratio: float = 0.01  # 1 sigma of the configured inertia's error

    @cached_property
    def axes(self) -> FloatArray:
        """Return the unit axes (3, k) of the k wheels in B."""
        return np.stack([rotor.unit for rotor in self.rotors], axis=1)

    @cached_property
    def inertias_kg_m2(self) -> FloatArray:
        """Return the axial inertias (k,)."""
        return np.array([rotor.inertia_kg_m2 for rotor in self.rotors])

    @cached_property
    def _share(self) -> FloatArray:
        return np.asarray(np.linalg.pinv(self.axes), np.float64)

    def motor_torque_nm(self, turned: FloatArray, w_B: FloatArray, speed: FloatArray) -> FloatArray:
        """Return the motors' torques on the rotors (k,), within the limits of torque and speed.

        Parameters
        ----------
        turned : (3,) vector part of the base's quaternion from the attitude to be held
        w_B : (3,) rate of the base [rad/s]
        speed : (k,) speeds of the rotors [rad/s]
        """
        wanted = -2.0 * self.stiffness_nm_rad * turned - self.damping_nms_rad * w_B
        limit = self.torque_limit_nm
        torque = np.clip(-self._share @ wanted, -limit, limit)
        room = 1.0 - np.sign(torque) * speed / self.speed_limit_rad_s
        return np.asarray(torque * np.clip(room / TAPER_RATIO, 0.0, 1.0))
