"""External force and torque on every body of the robot, as the wrench of the truth."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import mujoco
import numba
import numpy as np

from hil.world.environment import density
from hil.world.environment.config import (
    AtmosphereSection,
    CuboidSection,
    EnvironmentSection,
    RadiationSection,
)
from hil.world.environment.constants import AU_M, SOLAR_PRESSURE_PA
from hil.world.environment.field import OrbitalField
from hil.world.environment.gravity import add_body_wrench
from hil.world.environment.orbit import FloatArray, Orbit
from hil.world.environment.plates import (
    Air,
    Plates,
    add_air_force,
    add_light_force,
    cuboid,
    together,
    uniform_size_m,
)
from hil.world.environment.sun_moon import epoch_tt, is_lit, sun_m
from hil.world.robot import Robot

GRID_S = 5.0  # step of tables along the orbit: 0.3 deg in LEO
MARGIN_S = 60.0  # tables extend this far beyond the requested interval


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Air, sunlight and gravity of Sun and Moon at k times: (k,) and (k, 3), vectors in N."""

    start_s: float
    v_air_m_s: FloatArray
    rho_kg_m3: FloatArray
    s_hat: FloatArray
    pressure_pa: FloatArray  # zero in the Earth's shadow
    uniform_m_s2: FloatArray  # gravity of Sun and Moon

    def at(self, t_s: float) -> tuple[FloatArray, float, FloatArray, float, FloatArray]:
        """Return the five quantities at a time, linear between the points of the grid."""
        x = (t_s - self.start_s) / GRID_S
        i = min(max(int(x), 0), len(self.rho_kg_m3) - 2)
        b = x - i
        a = 1.0 - b
        return (
            a * self.v_air_m_s[i] + b * self.v_air_m_s[i + 1],
            float(a * self.rho_kg_m3[i] + b * self.rho_kg_m3[i + 1]),
            a * self.s_hat[i] + b * self.s_hat[i + 1],
            float(a * self.pressure_pa[i] + b * self.pressure_pa[i + 1]),
            a * self.uniform_m_s2[i] + b * self.uniform_m_s2[i + 1],
        )


class Environment:
    """The environment of one robot over one interval of time; call it as the truth's wrench.

    Plates do not shade each other. The arm's surfaces are left out, and so is the wind of motion
    relative to the orbit (centimetres per second). The Earth's shadow is a cylinder.

    Parameters
    ----------
    section : orbit and effects that act
    robot : the compiled model; its root body is the base, "grasped target" the target
    start_s, end_s : interval over which the truth is simulated
    """

    def __init__(
        self, section: EnvironmentSection, robot: Robot, start_s: float, end_s: float
    ) -> None:
        self.section = section
        self.orbit = Orbit.from_section(section.orbit)
        epoch = epoch_tt(section.orbit.epoch_utc)
        self.field = OrbitalField(self.orbit, epoch, section.gravity_gradient, section.third_body)
        self._mass_kg = robot.model.body_mass.copy()
        self._moments = robot.model.body_inertia.copy()
        self._plates = _plates(robot, section.surfaces)
        self._com_m = robot.model.body_ipos[self._plates.body]
        self._air = Air.of(section.atmosphere or AtmosphereSection())
        light = section.solar_pressure or RadiationSection()
        scattered = 1.0 - light.absorbed_ratio - light.mirrored_ratio
        self._optics = (light.mirrored_ratio, scattered)
        t_s = np.arange(start_s - MARGIN_S, end_s + MARGIN_S + GRID_S, GRID_S)
        self._around = self._surroundings(t_s, epoch)

    def __call__(self, t_s: float, data: mujoco.MjData) -> None:
        """Add force and torque at every body's centre of mass to data.xfrc_applied."""
        v_air, rho, s_hat, pressure, uniform = self._around.at(t_s)
        plates = self._plates
        _add_plates(
            plates.body, plates.area_m2, plates.normal, plates.centre_m - self._com_m,
            data.xmat, v_air, rho, self._air, s_hat, pressure, self._optics, data.xfrc_applied,
        )  # fmt: skip
        up = self.orbit.up_at(t_s)
        rate = self.orbit.rate_rad_s if self.section.gravity_gradient else 0.0
        _add_gravity(
            self._mass_kg, self._moments, data.xipos, data.ximat, up, rate, uniform,
            data.xfrc_applied,
        )  # fmt: skip

    def _surroundings(self, t_s: FloatArray, epoch: tuple[float, float]) -> Surroundings:
        place, sun = self.orbit.position_m(t_s), sun_m(epoch, t_s)
        to_sun = sun - place
        distance = np.linalg.norm(to_sun, axis=1)
        rho = np.zeros(len(t_s))
        if self.section.atmosphere is not None:
            rho = self._density(self.section.atmosphere, place, sun)
        pressure = np.zeros(len(t_s))
        if self.section.solar_pressure is not None:
            pressure = SOLAR_PRESSURE_PA * (AU_M / distance) ** 2 * is_lit(place, sun)
        return Surroundings(
            start_s=float(t_s[0]),
            v_air_m_s=self.orbit.velocity_in_air_m_s(t_s),
            rho_kg_m3=rho,
            s_hat=to_sun / distance[:, None],
            pressure_pa=pressure,
            uniform_m_s2=self.field.at(t_s)[0],
        )

    def _density(self, air: AtmosphereSection, place: FloatArray, sun: FloatArray) -> FloatArray:
        if air.density_kg_m3 is not None:
            return np.full(len(place), air.density_kg_m3)
        if air.density == "table":
            return density.along_track(place, sun, air.activity)
        from hil.world.environment import jb2006  # starts a Java machine

        date = datetime.fromisoformat(self.section.orbit.epoch_utc)
        return jb2006.along_track(place, sun, air.activity, date)


@numba.njit(cache=True)
def _add_plates(
    bodies: FloatArray, area_m2: FloatArray, normal: FloatArray, lever_m: FloatArray,
    attitude: FloatArray, v_air: FloatArray, rho: float, air: Air, s_hat: FloatArray,
    pressure: float, optics: tuple[float, float], applied: FloatArray,
) -> None:  # fmt: skip
    """Add the forces of air and light on all plates; levers from each body's centre of mass."""
    v, s, force, torque = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for p in range(bodies.shape[0]):
        body = bodies[p]
        R = attitude[body].reshape(3, 3)
        for c in range(3):
            v[c] = R[0, c] * v_air[0] + R[1, c] * v_air[1] + R[2, c] * v_air[2]
            s[c] = R[0, c] * s_hat[0] + R[1, c] * s_hat[1] + R[2, c] * s_hat[2]
            force[c] = 0.0
        if rho > 0.0:
            add_air_force(normal[p], area_m2[p], v, rho, air, force)
        if pressure > 0.0:
            add_light_force(normal[p], area_m2[p], s, pressure, optics, force)
        r = lever_m[p]
        torque[0] = r[1] * force[2] - r[2] * force[1]
        torque[1] = r[2] * force[0] - r[0] * force[2]
        torque[2] = r[0] * force[1] - r[1] * force[0]
        for c in range(3):
            for k in range(3):
                applied[body, c] += R[c, k] * force[k]
                applied[body, 3 + c] += R[c, k] * torque[k]


@numba.njit(cache=True)
def _add_gravity(
    mass_kg: FloatArray, moments: FloatArray, centres: FloatArray, axes: FloatArray,
    up: FloatArray, rate_rad_s: float, uniform: FloatArray, applied: FloatArray,
) -> None:  # fmt: skip
    """Add the gradient's wrench and the uniform gravity to every body; rate 0: no gradient."""
    middle, place, total = np.zeros(3), np.zeros(3), 0.0
    for body in range(mass_kg.shape[0]):
        total += mass_kg[body]
        for c in range(3):
            middle[c] += mass_kg[body] * centres[body, c]
    for body in range(mass_kg.shape[0]):
        for c in range(3):
            place[c] = centres[body, c] - middle[c] / total
            applied[body, c] += mass_kg[body] * uniform[c]
        turned = axes[body].reshape(3, 3)
        add_body_wrench(mass_kg[body], place, turned, moments[body], up, rate_rad_s, applied[body])


def _plates(robot: Robot, surfaces: Mapping[Any, CuboidSection]) -> Plates:
    """Return the plates of base and target.

    Source of the default sizes: Table 1's moments are those of uniform cuboids about the centre of
    mass; products of inertia are ignored.
    """
    model = robot.model
    bodies = {"base": 1}
    target = model.nbody - 1
    if model.body(target).name == "grasped target":
        bodies["target"] = target
    found = []
    for name, body in bodies.items():
        section = surfaces.get(name, CuboidSection())
        mass = float(model.body_mass[body])
        size = np.array(section.size_m) if section.size_m is not None else None
        if size is None:
            size = uniform_size_m(mass, _moments(model, body))
        centre = section.centre_m if section.centre_m is not None else model.body_ipos[body]
        found.append(cuboid(body, size, np.array(centre)))
    return together(found)


def _moments(model: mujoco.MjModel, body: int) -> FloatArray:
    """Return the moments (xx, yy, zz) about the centre of mass in the body's own axes."""
    w, x, y, z = model.body_iquat[body]
    v = np.array([x, y, z])
    R = np.eye(3) + 2.0 * w * _skew(v) + 2.0 * _skew(v) @ _skew(v)
    return np.asarray(np.einsum("ij,j,ij->i", R, model.body_inertia[body], R))


def _skew(v: FloatArray) -> FloatArray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
