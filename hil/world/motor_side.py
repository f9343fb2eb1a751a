"""What a torque from motor current holds besides the link's: rotor inertia, ripple of gears."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.world.inertia import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotorSide:
    """Rotors and gears of n joints with r ripples each."""

    rotor_inertia_kg_m2: FloatArray  # (n,) about the joint's axis, times the gear ratio squared
    ripple_nm: FloatArray  # (2, r, n) amplitudes of sine and cosine
    ripple_periods: FloatArray  # (r,) in a turn of the joint

    def torque_nm(self, q: FloatArray, qdd: FloatArray) -> FloatArray:
        """Return the torque [N m] in addition to the link's.

        `q` [rad], `qdd` [rad/s^2] and the result are (..., n).
        """
        torque = self.rotor_inertia_kg_m2 * qdd
        for sine, cosine, periods in zip(*self.ripple_nm, self.ripple_periods, strict=True):
            torque = torque + sine * np.sin(periods * q) + cosine * np.cos(periods * q)
        return np.asarray(torque)


def draw_motor_side(
    rng: np.random.Generator,
    n: int,
    *,
    rotor_inertia_sigma_kg_m2: float,
    ripple_sigma_nm: float,
    ripple_periods: tuple[float, ...],
) -> MotorSide:
    """Draw the motor side of n joints; inertias are half normal, amplitudes normal."""
    return MotorSide(
        rotor_inertia_kg_m2=rotor_inertia_sigma_kg_m2 * np.abs(rng.standard_normal(n)),
        ripple_nm=ripple_sigma_nm * rng.standard_normal((2, len(ripple_periods), n)),
        ripple_periods=np.array(ripple_periods),
    )
