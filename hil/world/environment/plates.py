"""Forces on flat plates: free molecular flow and sunlight; and the plates of a cuboid.

The functions are compiled, because the truth calls them at every stage of every step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from hil.world.environment.config import AtmosphereSection
from hil.world.environment.constants import GAS_CONSTANT_J_MOL_K
from hil.world.environment.orbit import FloatArray

GRAZING = 1e-12  # sine below which a plate has no direction of shear


@dataclass(frozen=True, slots=True, eq=False)
class Plates:
    """Flat plates, each in the axes of its body.

    Air and sunlight act only on the side of the outward normal.
    """

    body: FloatArray  # (p,) number of the body, integer
    area_m2: FloatArray  # (p,)
    normal: FloatArray  # (p, 3) outward
    centre_m: FloatArray  # (p, 3)


class Air(NamedTuple):
    """Parameters of free molecular flow besides density and velocity."""

    normal: float  # accommodation ratio
    tangential: float
    wall: float  # sqrt(wall temperature / air temperature)
    thermal_m_s: float  # sqrt(2 R_s T)

    @staticmethod
    def of(section: AtmosphereSection) -> Air:
        """Return the parameters from a section of the scenario."""
        specific = GAS_CONSTANT_J_MOL_K / section.molar_mass_kg_mol
        return Air(
            section.normal_accommodation_ratio,
            section.tangential_accommodation_ratio,
            math.sqrt(section.wall_temperature_k / section.temperature_k),
            math.sqrt(2.0 * specific * section.temperature_k),
        )


def cuboid(body: int, size_m: FloatArray, centre_m: FloatArray) -> Plates:
    """Return the six faces of a cuboid along the body's axes."""
    x, y, z = size_m
    areas = np.array([y * z, z * x, x * y])
    normal = np.concatenate([np.eye(3), -np.eye(3)])
    centres = centre_m + 0.5 * normal * size_m
    return Plates(np.full(6, body), np.tile(areas, 2), normal, centres)


def together(parts: list[Plates]) -> Plates:
    """Return the plates of several bodies in one object."""
    return Plates(
        np.concatenate([p.body for p in parts]),
        np.concatenate([p.area_m2 for p in parts]),
        np.concatenate([p.normal for p in parts]),
        np.concatenate([p.centre_m for p in parts]),
    )


def uniform_size_m(mass_kg: float, inertia_kg_m2: FloatArray) -> FloatArray:
    """Return the edges of the uniform cuboid with these moments (xx, yy, zz) about its centre.

    I_xx = m (b^2 + c^2) / 12 and so on, solved for the edges.

    Raises
    ------
    ValueError if no cuboid has these moments.
    """
    square = 6.0 / mass_kg * (inertia_kg_m2.sum() - 2.0 * inertia_kg_m2)
    if not np.all(square > 0):
        raise ValueError(f"moments {inertia_kg_m2.tolist()} belong to no uniform cuboid")
    return np.asarray(np.sqrt(square))


@numba.njit(cache=True)
def add_air_force(
    n: FloatArray, area_m2: float, v_m_s: FloatArray, rho: float, air: Air, force: FloatArray
) -> None:
    """Add the force of free molecular flow on a plate with outward normal n (3,).

    `v_m_s` (3,) is the plate's velocity relative to the air, `rho` its density [kg/m^3]; normal,
    velocity and force in the same axes. F = rho V^2 A / 2 (-C_p n - C_t t) with
    C_p = s^-2 {[(2 - an) x / sqrt(pi) + an/2 sqrt(Tw/T)] e + [(2 - an)(1/2 + x^2)
    + an/2 sqrt(Tw/T) sqrt(pi) x] E}, C_t = at sin(d) / (s sqrt(pi)) {e + sqrt(pi) x E},
    x = s cos(d), e = exp(-x^2), E = 1 + erf(x). Source: Schaaf and Chambre (1961).
    """
    speed2 = v_m_s[0] ** 2 + v_m_s[1] ** 2 + v_m_s[2] ** 2
    speed = math.sqrt(speed2)
    s = speed / air.thermal_m_s
    cosine = (n[0] * v_m_s[0] + n[1] * v_m_s[1] + n[2] * v_m_s[2]) / speed
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    x, root_pi = s * cosine, math.sqrt(math.pi)
    e, E = math.exp(-x * x), 1.0 + math.erf(x)
    warm, rest = 0.5 * air.normal * air.wall, 2.0 - air.normal
    C_p = ((rest * x / root_pi + warm) * e + (rest * (0.5 + x * x) + warm * root_pi * x) * E) / s**2
    C_t = air.tangential * sine / (s * root_pi) * (e + root_pi * x * E)
    pressure = 0.5 * rho * speed2 * area_m2
    for c in range(3):
        shear = (v_m_s[c] / speed - cosine * n[c]) / sine if sine > GRAZING else 0.0
        force[c] -= pressure * (C_p * n[c] + C_t * shear)


@numba.njit(cache=True)
def add_light_force(
    n: FloatArray,
    area_m2: float,
    s_hat: FloatArray,
    pressure_pa: float,
    optics: tuple[float, float],
    force: FloatArray,
) -> None:
    """Add the force of sunlight from direction `s_hat` (3,) on a plate; none on its back.

    `optics` are the mirrored and the scattered ratio. Source: Wertz (1978), eqs. 17-66 to 17-69:
    F = -P A cos(b) [(1 - C_s) s + 2 (C_s cos(b) + C_d / 3) n].
    """
    mirrored, scattered = optics
    cosine = n[0] * s_hat[0] + n[1] * s_hat[1] + n[2] * s_hat[2]
    if cosine <= 0.0:
        return
    along_n = 2.0 * (mirrored * cosine + scattered / 3.0)
    for c in range(3):
        push = (1.0 - mirrored) * s_hat[c] + along_n * n[c]
        force[c] -= pressure_pa * area_m2 * cosine * push
