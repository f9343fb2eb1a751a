"""Plates in thin air and sunlight against closed forms of whole bodies and limits."""

import math

import numpy as np
import pytest

from hil.world.environment.config import AtmosphereSection
from hil.world.environment.plates import Air, add_air_force, add_light_force, cuboid, uniform_size_m

RHO = 1e-12
SPEED = 7111.0
CUBE = cuboid(1, np.array([1.0, 1.0, 1.0]), np.zeros(3))


def air(**changes: float) -> Air:
    return Air.of(AtmosphereSection(**changes))


def drag(normals: np.ndarray, areas: np.ndarray, v: np.ndarray, flow: Air) -> np.ndarray:
    force = np.zeros((len(areas), 3))
    for n, area, out in zip(normals, areas, force, strict=True):
        add_air_force(n, area, v, RHO, flow, out)
    return force


def coefficient(force: np.ndarray, area: float, speed: float = SPEED) -> float:
    return float(-force[0] / (0.5 * RHO * speed**2 * area))


def sphere(count: int = 40_000) -> tuple[np.ndarray, np.ndarray]:
    """Normals of equal plates that tile the unit sphere (Fibonacci), and their areas."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + 5.0**0.5) * k
    r = np.sqrt(1.0 - z * z)
    normals = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
    return normals, np.full(count, 4.0 * np.pi / count)


def test_face_on_cube_has_the_noted_drag():
    """Accommodation 1.0 and 0.3, atomic oxygen of 1000 K on a wall of 300 K: C_d = 2.26."""
    force = drag(CUBE.normal, CUBE.area_m2, np.array([SPEED, 0.0, 0.0]), air())
    assert coefficient(force.sum(axis=0), 1.0) == pytest.approx(2.26, rel=5e-3)
    assert np.abs(force.sum(axis=0)[1:]).max() < 1e-9 * abs(force.sum(axis=0)[0])
    lever = CUBE.centre_m
    assert np.abs(np.cross(lever, force).sum(axis=0)).max() < 1e-12 * np.abs(force).max()


@pytest.mark.parametrize("speed", [1500.0, SPEED])
def test_sphere_of_plates_has_the_drag_of_the_closed_form(speed: float):
    """Diffuse sphere in free molecular flow (Schaaf and Chambre 1961), both accommodations 1."""
    flow = air(tangential_accommodation_ratio=1.0)
    normals, areas = sphere()
    force = drag(normals, areas, np.array([speed, 0.0, 0.0]), flow).sum(axis=0)
    s = speed / flow.thermal_m_s
    expected = (
        (2 * s**2 + 1) / (math.sqrt(math.pi) * s**3) * math.exp(-(s**2))
        + (4 * s**4 + 4 * s**2 - 1) / (2 * s**4) * math.erf(s)
        + 2 * math.sqrt(math.pi) / (3 * s) * flow.wall
    )
    assert coefficient(force, math.pi, speed) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(("accommodation", "expected"), [(0.0, 4.0), (1.0, 2.0)])
def test_fast_flow_on_a_plate_is_newtonian(accommodation: float, expected: float):
    """Cold gas, s = 1000: a mirror turns the momentum round (C_p 4), a cold absorber takes it."""
    flow = air(
        normal_accommodation_ratio=accommodation,
        tangential_accommodation_ratio=0.0,
        temperature_k=0.05,
        wall_temperature_k=1e-9,
    )
    n = np.array([[1.0, 0.0, 0.0]])
    force = drag(n, np.ones(1), np.array([SPEED, 0.0, 0.0]), flow)[0]
    assert coefficient(force, 1.0) == pytest.approx(expected, rel=1e-3)


def test_still_plate_behind_feels_nothing():
    force = drag(np.array([[-1.0, 0.0, 0.0]]), np.ones(1), np.array([SPEED, 0.0, 0.0]), air())
    assert np.abs(force).max() < 1e-9 * 0.5 * RHO * SPEED**2


def light(n: np.ndarray, s: np.ndarray, area: float, optics: tuple[float, float]) -> np.ndarray:
    force = np.zeros(3)
    add_light_force(n, area, s, 4.54e-6, optics, force)
    return force


def test_sunlight_on_a_cube_has_the_noted_force():
    """2 m cube, half absorbed and half mirrored: P A (1 + C_s) = 2.7e-5 N."""
    n, s = np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])
    faces = cuboid(1, np.full(3, 2.0), np.zeros(3))
    force = sum(
        light(k, s, a, (0.5, 0.0)) for k, a in zip(faces.normal, faces.area_m2, strict=True)
    )
    assert np.linalg.norm(force) == pytest.approx(2.7e-5, rel=1e-2)
    assert force @ n == pytest.approx(-4.54e-6 * 4.0 * 1.5, rel=1e-9)


def test_a_slanted_mirror_is_pushed_along_its_normal_and_black_along_the_light():
    n = np.array([0.6, 0.8, 0.0])
    s = np.array([1.0, 0.0, 0.0])
    mirror = light(n, s, 2.0, (1.0, 0.0))
    black = light(n, s, 2.0, (0.0, 0.0))
    assert np.allclose(mirror, -2 * 4.54e-6 * 2.0 * 0.6**2 * n, rtol=1e-12, atol=0)
    assert np.allclose(black, -4.54e-6 * 2.0 * 0.6 * s, rtol=1e-12, atol=0)
    assert not light(-n, s, 2.0, (0.5, 0.2)).any()


def test_scattering_sphere_has_the_force_of_the_closed_form():
    """Diffuse sphere: P pi r^2 (1 + 4/9) (Wertz 1978)."""
    normals, areas = sphere(20_000)
    s = np.array([0.0, 0.0, 1.0])
    force = sum(light(n, s, a, (0.0, 1.0)) for n, a in zip(normals, areas, strict=True))
    assert -force[2] == pytest.approx(4.54e-6 * math.pi * (1 + 4 / 9), rel=1e-3)


def test_the_papers_inertias_are_those_of_cuboids():
    """Table 1: base 1.5 x 1.5 x 3.0 m, targets 1.936 m and 1.749 x 2.107 x 2.478 m."""
    assert np.allclose(uniform_size_m(1000.0, np.array([937.5, 937.5, 375.0])), [1.5, 1.5, 3.0])
    assert np.allclose(uniform_size_m(400.0, np.full(3, 250.0)), 1.936, atol=1e-3)
    geo = uniform_size_m(1200.0, np.array([1058.0, 920.0, 750.0]))
    assert np.allclose(geo, [1.749, 2.107, 2.478], atol=1e-3)
    with pytest.raises(ValueError, match="cuboid"):
        uniform_size_m(1.0, np.array([1.0, 0.1, 0.1]))
