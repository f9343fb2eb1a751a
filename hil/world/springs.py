"""Parts of the base that move on springs: liquid in tanks, hinged panels; and their forces."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

from hil.world.inertia import pi_of, symmetric

FloatArray = NDArray[np.float64]
WALL_HZ = 1.0  # natural frequency of a liquid's mass at the tank's wall; low for the time step


@dataclass(frozen=True, slots=True, kw_only=True)
class SloshMass:
    """Liquid that moves in a tank of the base: a mass on springs, one slide per axis.

    The inertial data of the base include the liquid at rest.
    """

    mass_kg: float
    place_m: tuple[float, float, float]  # at rest, base frame
    axes: tuple[tuple[float, float, float], ...] = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    frequency_hz: float  # if the tank is held
    damping_ratio: float
    stroke_m: float  # displacement at which the wall begins

    @property
    def pi(self) -> FloatArray:
        """Return the part's pi (10,) at rest in the base frame (see `hil.world.inertia`)."""
        return pi_of(np.array([self.mass_kg, *self.place_m, *np.zeros(6)]))

    @property
    def moved(self) -> float:
        """Return the mass on each spring [kg]."""
        return self.mass_kg


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """A panel on a hinge with spring and damper; the base's data include the panel at rest."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    mass_kg: float
    place_m: tuple[float, float, float]  # of the hinge, base frame
    axis: tuple[float, float, float]  # of the hinge, any length
    com_m: tuple[float, float, float]  # from the hinge
    inertia_kg_m2: tuple[float, float, float, float, float, float]  # about the centre of mass
    frequency_hz: float  # if the base is held
    damping_ratio: float
    stroke_m: float = np.inf  # in rad; infinite: no stop

    @property
    def axes(self) -> tuple[tuple[float, float, float], ...]:
        """Return the hinge's axis."""
        return (self.axis,)

    @property
    def pi(self) -> FloatArray:
        """Return the part's pi (10,) at rest in the base frame (see `hil.world.inertia`)."""
        com = np.add(self.place_m, self.com_m)
        return pi_of(np.array([self.mass_kg, *com, *self.inertia_kg_m2]))

    @property
    def moved(self) -> float:
        """Return the panel's inertia about the hinge [kg m^2]."""
        a = np.array(self.axis) / np.linalg.norm(self.axis)
        lever = np.cross(a, self.com_m)
        own = a @ symmetric(np.array(self.inertia_kg_m2)) @ a
        return float(own + self.mass_kg * lever @ lever)


Sprung = SloshMass | Panel


class Springs:
    """Springs and dampers k = m w^2, d = 2 zeta m w (m: mass or inertia), and a tank's wall.

    Beyond the stroke the wall acts as a spring of WALL_HZ with half the critical damping.
    """

    def __init__(self, parts: Sequence[Sprung]) -> None:
        """Compute the gains; `parts` has one entry per coordinate."""
        mass = np.array([part.moved for part in parts])
        rate = 2.0 * np.pi * np.array([part.frequency_hz for part in parts])
        self._stiffness = mass * rate**2
        self._damping = 2.0 * np.array([part.damping_ratio for part in parts]) * mass * rate
        self._stroke = np.array([part.stroke_m for part in parts])
        wall_rate = 2.0 * np.pi * WALL_HZ
        self._wall = mass * wall_rate**2
        self._wall_damping = mass * wall_rate

    def force_n(self, x_m: FloatArray, v_m_s: FloatArray) -> FloatArray:
        """Return the force on every coordinate (s,) [N, N m] at displacement x and speed v."""
        beyond = np.sign(x_m) * np.maximum(np.abs(x_m) - self._stroke, 0.0)
        wall = self._wall * beyond + self._wall_damping * v_m_s * (beyond != 0.0)
        return np.asarray(-self._stiffness * x_m - self._damping * v_m_s - wall)
