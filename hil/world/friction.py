"""Friction of bearing, seal and cables on the link side, which the torque sensor measures."""

from dataclasses import dataclass

import numpy as np

from hil.world.inertia import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointFriction:
    """Coulomb and viscous friction of n joints, of either sign: the residual of a compensation.

    The Coulomb part is linear in the rate between -speed_rad_s and speed_rad_s.
    """

    coulomb_nm: FloatArray  # (n,)
    viscous_nms_rad: FloatArray  # (n,)
    speed_rad_s: float

    def torque_nm(self, qd: FloatArray) -> FloatArray:
        """Return the friction in the measured torque [N m] at joint rates (..., n) [rad/s]."""
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
    """Draw the friction of n joints from normal distributions with mean zero."""
    coulomb, viscous = rng.standard_normal((2, n))
    return JointFriction(
        coulomb_nm=coulomb_sigma_nm * coulomb,
        viscous_nms_rad=viscous_sigma_nms_rad * viscous,
        speed_rad_s=speed_rad_s,
    )
