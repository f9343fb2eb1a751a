"""Panels and liquid under a base's acceleration: closed forms, points of mass, differences."""

import numpy as np

from fsw.config import ModeConfig
from planner.shaking import Shaking

LIQUID = ModeConfig(
    name="tank",
    kind="slosh",
    p_B_m=(0.0, 0.3, 0.0),
    mass_kg=25.0,
    frequency_hz=0.1,
    damping_ratio=0.02,
    amplitude_m=0.01,
)
POINTS = np.array([[1.0, 0.2, 0.1], [2.0, -0.3, 0.1], [1.5, 0.1, -0.4], [1.7, 0.0, 0.2]])
MASSES = np.array([4.0, 6.0, 3.0, 7.0])


def panel() -> tuple[ModeConfig, np.ndarray]:
    """Return a panel made of points of mass, and their places from its hinge."""
    com = MASSES @ POINTS / MASSES.sum()
    r = POINTS - com
    inertia = sum(m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(MASSES, r, strict=True))
    mode = ModeConfig(
        name="panel",
        kind="panel",
        p_B_m=(0.5, -0.2, 0.3),
        axes_B=((0.0, 0.6, 0.8),),
        mass_kg=float(MASSES.sum()),
        com_m=tuple(com),
        inertia_kg_m2=tuple(inertia[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]),
        frequency_hz=0.15,
        damping_ratio=0.005,
        amplitude_rad=0.01,
    )
    return mode, POINTS


def test_liquid_under_a_steady_acceleration_swings_about_its_new_place():
    step_s, count, a = 0.05, 400, 0.01
    shaking = Shaking(LIQUID, 0, count, step_s)
    zero = np.zeros((count, 3))
    x = shaking.swing((zero + np.array([a, 0.0, 0.0]), zero, zero), None)[0]
    w, z = 2 * np.pi * LIQUID.frequency_hz, LIQUID.damping_ratio
    # a force that rises in one step acts as one that begins in its middle, within (w step)^2 / 24
    t, wd = step_s * (np.arange(count) + 0.5), w * np.sqrt(1 - z**2)
    decay = np.exp(-z * w * t)
    expected = -a / w**2 * (1 - decay * (np.cos(wd * t) + z * w / wd * np.sin(wd * t)))
    np.testing.assert_allclose(x[:, 0], expected, atol=5e-6)
    assert np.abs(x).max() > 0.04


def test_a_panel_is_driven_by_what_carries_its_points_of_mass():
    """At a frequency far below the motion's the panel's second derivative is -Q / M."""
    mode, points = panel()
    step_s, count = 1e-3, 60
    shaking = Shaking(mode, 0, count, step_s)
    a, wd, w = np.array([0.3, -0.2, 0.1]), np.array([0.05, 0.2, -0.1]), np.array([0.1, -0.2, 0.15])
    motion = tuple(np.tile(v, (count, 1)) for v in (a, wd, w))
    u, r = np.array(mode.axes_B[0]), points + np.array(mode.p_B_m)
    carried = a + np.cross(wd, r) + np.cross(w, np.cross(w, r))
    Q = u @ (MASSES[:, None] * np.cross(points, carried)).sum(axis=0)
    lever = np.cross(u, points)
    M = (MASSES * (lever * lever).sum(axis=1)).sum()
    x = shaking.swing(motion, None)[0][-1, 0]
    np.testing.assert_allclose(x, -0.5 * Q / M * (step_s * (count - 0.5)) ** 2, rtol=1e-3)


def test_derivatives_are_those_of_differences():
    mode, _ = panel()
    rng = np.random.default_rng(2)
    shaking = Shaking(mode, 0, 12, 0.4)
    motion = tuple(0.1 * rng.standard_normal((12, 3)) for _ in range(3))
    ways = tuple(rng.standard_normal((12, 3, 2)) for _ in range(3))
    J = shaking.swing(motion, ways)[1]
    for v in range(2):
        h = 1e-6
        ends = [
            shaking.swing(
                tuple(m + s * h * d[..., v] for m, d in zip(motion, ways, strict=True)), None
            )[0]
            for s in (1, -1)
        ]
        np.testing.assert_allclose(J[..., v], (ends[0] - ends[1]) / (2 * h), atol=1e-8)
