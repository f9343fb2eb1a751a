"""Friction that a link-side torque sensor sees: of bearing, seal and cables beyond it."""

from dataclasses import dataclass

import numpy as np

from hil.world.inertia import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointFriction:
    """Coulomb and viscous friction of n joints; either sign, as a compensation leaves it.

    The Coulomb part turns over linearly between -speed and speed, where a joint creeps.
    """

    coulomb_nm: FloatArray  # (n,)
    viscous_nms_rad: FloatArray  # (n,)
    speed_rad_s: float

    def torque_nm(self, qd: FloatArray) -> FloatArray:
        """Return the share of friction in the measured torque at joint rates (..., n) [rad/s]."""
        direction = np.clip(qd / self.speed_rad_s, -1.0, 1.0)
        torque: FloatArray = self.coulomb_nm * direction + self.viscous_nms_rad * qd
        return torque


def draw_friction(
    rng: np.random.Generator,
    n: int,
    *,
    coulomb_sigma_nm: float,
    viscous_sigma_nms_rad: float,
    speed_rad_s: float = 0.01,
) -> JointFriction:
    """Draw the friction of n joints, Gaussian about none."""
    coulomb, viscous = rng.standard_normal((2, n))
    return JointFriction(
        coulomb_nm=coulomb_sigma_nm * coulomb,
        viscous_nms_rad=viscous_sigma_nms_rad * viscous,
        speed_rad_s=speed_rad_s,
    )
