"""The Earth's gravity gradient on extended bodies."""

import numba
import numpy as np

from hil.world.environment.orbit import FloatArray


def gradient_1_s2(up: FloatArray, rate_rad_s: float) -> FloatArray:
    """Return G (..., 3, 3) = mu/R^3 (3 r r^T - 1) in N: G d is the field at offset d."""
    outer = 3.0 * up[..., :, None] * up[..., None, :]
    return np.asarray(rate_rad_s**2 * (outer - np.eye(3)))


@numba.njit(cache=True)
def add_body_wrench(
    mass_kg: float,
    place_m: FloatArray,
    axes: FloatArray,
    moments_kg_m2: FloatArray,
    up: FloatArray,
    rate_rad_s: float,
    wrench: FloatArray,
) -> None:
    """Add force [N] and torque about the body's centre of mass [N m] to `wrench` (6,).

    f = m mu/R^3 [3 (r . d) r - d] and t = 3 mu/R^3 r x (I r), with r = `up` and d = `place_m` from
    the system's centre of mass; `axes` (3, 3) has the principal axes as columns. Each body has its
    own wrench, so that joints are loaded. Source: Hughes (1986), sec. 8.1, for each body.
    """
    k = rate_rad_s * rate_rad_s
    along = up[0] * place_m[0] + up[1] * place_m[1] + up[2] * place_m[2]
    for c in range(3):
        wrench[c] += mass_kg * k * (3.0 * along * up[c] - place_m[c])
    r0 = axes[0, 0] * up[0] + axes[1, 0] * up[1] + axes[2, 0] * up[2]
    r1 = axes[0, 1] * up[0] + axes[1, 1] * up[1] + axes[2, 1] * up[2]
    r2 = axes[0, 2] * up[0] + axes[1, 2] * up[1] + axes[2, 2] * up[2]
    t0 = r1 * r2 * (moments_kg_m2[2] - moments_kg_m2[1])
    t1 = r2 * r0 * (moments_kg_m2[0] - moments_kg_m2[2])
    t2 = r0 * r1 * (moments_kg_m2[1] - moments_kg_m2[0])
    for c in range(3):
        wrench[3 + c] += 3.0 * k * (axes[c, 0] * t0 + axes[c, 1] * t1 + axes[c, 2] * t2)
