"""A circular orbit about the Earth, in inertial equatorial axes N."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hil.world.environment.config import OrbitSection
from hil.world.environment.constants import EARTH_GM_M3_S2, EARTH_RADIUS_M, EARTH_RATE_RAD_S

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Orbit:
    """A circular orbit: radius, and unit vectors in N to the craft at t = 0 and a quarter later."""

    radius_m: float
    up_N: FloatArray  # (3,)
    along_N: FloatArray  # (3,)

    @staticmethod
    def from_section(section: OrbitSection) -> Orbit:
        """Build the orbit from altitude above the equatorial radius and angles."""
        node, u, i = (
            section.ascending_node_rad,
            section.latitude_argument_rad,
            section.inclination_rad,
        )
        toward_node = np.array([math.cos(node), math.sin(node), 0.0])
        beyond = np.array(
            [-math.sin(node) * math.cos(i), math.cos(node) * math.cos(i), math.sin(i)]
        )
        return Orbit(
            radius_m=EARTH_RADIUS_M + section.altitude_m,
            up_N=math.cos(u) * toward_node + math.sin(u) * beyond,
            along_N=-math.sin(u) * toward_node + math.cos(u) * beyond,
        )

    @property
    def rate_rad_s(self) -> float:
        """Angular rate sqrt(mu / R^3) [rad/s]."""
        return math.sqrt(EARTH_GM_M3_S2 / self.radius_m**3)

    @property
    def speed_m_s(self) -> float:
        """Inertial speed [m/s]."""
        return self.rate_rad_s * self.radius_m

    @property
    def period_s(self) -> float:
        """Time of one revolution [s]."""
        return 2.0 * math.pi / self.rate_rad_s

    def up(self, t_s: ArrayLike) -> FloatArray:
        """Return unit vectors (k, 3) in N from the Earth's centre to the craft at times (k,)."""
        angle = self.rate_rad_s * np.asarray(t_s)[..., None]
        return np.asarray(np.cos(angle) * self.up_N + np.sin(angle) * self.along_N)

    def up_at(self, t_s: float) -> FloatArray:
        """Return the unit vector (3,) in N from the Earth's centre to the craft at one time."""
        angle = self.rate_rad_s * t_s
        return math.cos(angle) * self.up_N + math.sin(angle) * self.along_N

    def position_m(self, t_s: ArrayLike) -> FloatArray:
        """Return positions (k, 3) in N [m]."""
        return self.radius_m * self.up(t_s)

    def velocity_m_s(self, t_s: ArrayLike) -> FloatArray:
        """Return inertial velocities (k, 3) in N [m/s]."""
        angle = self.rate_rad_s * np.asarray(t_s)[..., None]
        return np.asarray(
            self.speed_m_s * (np.cos(angle) * self.along_N - np.sin(angle) * self.up_N)
        )

    def velocity_in_air_m_s(self, t_s: ArrayLike) -> FloatArray:
        """Return velocities (k, 3) relative to air that turns with the Earth, in N [m/s]."""
        spin = np.array([0.0, 0.0, EARTH_RATE_RAD_S])
        return np.asarray(self.velocity_m_s(t_s) - np.cross(spin, self.position_m(t_s)))
