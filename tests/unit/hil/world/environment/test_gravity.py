"""The gravity gradient against Newton's law on point masses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.world.environment.gravity import add_body_wrench

MU = 3.986004418e14
RADIUS_M = 6_878_137.0
RATE = (MU / RADIUS_M**3) ** 0.5
UP = np.array([0.36, 0.48, 0.8])


def newton(place_m: np.ndarray) -> np.ndarray:
    """Attraction per kg at places (k, 3) from the orbit's point, less that at the point."""
    p = RADIUS_M * UP + place_m
    there = -MU * p / np.linalg.norm(p, axis=-1, keepdims=True) ** 3
    return there + MU * UP / RADIUS_M**2


def wrench(mass: float, place: np.ndarray, axes: np.ndarray, moments: np.ndarray) -> np.ndarray:
    out = np.zeros(6)
    add_body_wrench(mass, place, np.ascontiguousarray(axes), moments, UP, RATE, out)
    return out


def cuboid_points(size: np.ndarray) -> np.ndarray:
    """Eight points of equal mass with the uniform cuboid's moments: at edge / sqrt(12)."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return signs * size / np.sqrt(12.0)


@pytest.mark.parametrize("size", [[1.5, 1.5, 3.0], [0.2, 4.0, 1.0]])
def test_force_and_torque_are_newtons_on_points(size: list[float]):
    """Within 1e-4, the next term of the expansion being d/R ~ 1e-6 and rounding 1e-5."""
    R = Rotation.from_euler("xyz", [0.3, -0.8, 1.1]).as_matrix()
    mass, place, edges = 1000.0, np.array([2.0, -1.0, 0.5]), np.array(size)
    points = cuboid_points(edges) @ R.T
    force = mass / 8 * newton(place + points)
    moments = mass / 12 * (edges @ edges - edges**2)
    found = wrench(mass, place, R, moments)
    torque = np.cross(points, force).sum(axis=0)
    assert np.abs(found[:3] - force.sum(axis=0)).max() < 1e-4 * np.abs(force).max()
    assert np.abs(found[3:] - torque).max() < 1e-4 * np.linalg.norm(torque)


def test_a_uniform_cube_feels_no_torque_and_no_force_at_the_centre():
    R = Rotation.from_euler("xyz", [0.3, -0.8, 1.1]).as_matrix()
    found = wrench(400.0, np.zeros(3), R, np.full(3, 250.0))
    assert np.abs(found).max() < 1e-18


def test_parts_add_up_to_the_whole():
    """No net force; torque 3 mu/R^3 r x (I r) with the whole's inertia (parallel axes)."""
    rng = np.random.default_rng(4)
    masses = rng.uniform(1.0, 500.0, 6)
    places = rng.normal(size=(6, 3))
    places -= masses @ places / masses.sum()
    force, torque, whole = np.zeros(3), np.zeros(3), np.zeros((3, 3))
    for mass, place in zip(masses, places, strict=True):
        R = Rotation.random(rng=rng).as_matrix()
        moments = mass * rng.uniform(0.8, 1.2, 3)
        part = wrench(mass, place, R, moments)
        force += part[:3]
        torque += part[3:] + np.cross(place, part[:3])
        steiner = mass * (place @ place * np.eye(3) - np.outer(place, place))
        whole += R @ np.diag(moments) @ R.T + steiner
    expected = 3 * RATE**2 * np.cross(UP, whole @ UP)
    assert np.abs(force).max() < 1e-12
    assert np.allclose(torque, expected, rtol=1e-9)
