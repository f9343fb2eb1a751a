"""The gravity field around the robot, relative to the free fall of the orbit."""

from dataclasses import dataclass

import numpy as np

from hil.world.environment.gravity import gradient_1_s2
from hil.world.environment.orbit import FloatArray, Orbit
from hil.world.environment.sun_moon import third_body_m_s2


@dataclass(frozen=True, slots=True, eq=False)
class OrbitalField:
    """Field in the freely falling frame of the orbit: g(p) = uniform + G (p - centre of mass)."""

    orbit: Orbit
    epoch_tt: tuple[float, float]
    gravity_gradient: bool
    third_body: bool

    def at(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the uniform part (k, 3) [m/s^2] and G (k, 3, 3) [1/s^2] at the times, in N."""
        t = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        uniform = np.zeros((len(t), 3))
        gradient = np.zeros((len(t), 3, 3))
        if self.third_body:
            uniform = third_body_m_s2(self.orbit.position_m(t), self.epoch_tt, t)
        if self.gravity_gradient:
            gradient = gradient_1_s2(self.orbit.up(t), self.orbit.rate_rad_s)
        return uniform, gradient
