"""Liquid and panels of the base: nothing at rest, their own frequency, momentum kept, a wall."""

from typing import Any

import mujoco
import numpy as np
import pytest

from hil.world.robot import Robot, without
from hil.world.springs import Panel, SloshMass
from hil.world.truth import simulate
from tests.support.truth_cases import BODIES, URDF, stand_in

CASE = stand_in(None)
BASE = BODIES["base"]
TANKS = (
    SloshMass(
        mass_kg=25.0, place_m=(0.8, 0.0, 0.1), frequency_hz=0.02, damping_ratio=0.01, stroke_m=0.2
    ),
    SloshMass(
        mass_kg=25.0, place_m=(0.8, -0.8, 0.8), frequency_hz=0.02, damping_ratio=0.01, stroke_m=0.2
    ),
)
PANEL = Panel(
    mass_kg=25.0,
    place_m=(0.855, -0.408, 1.441),
    axis=(2.0, 0.0, 0.0),
    com_m=(0.1, 0.0, 1.5),
    inertia_kg_m2=(18.75, 0.0, 0.0, 22.8, 0.0, 4.08),
    frequency_hz=0.5,
    damping_ratio=1e-6,
)


def mass_matrix(robot: Robot, q: np.ndarray) -> np.ndarray:
    data, slides = mujoco.MjData(robot.model), len(robot.slides)
    data.qpos[7 + slides :] = q
    mujoco.mj_forward(robot.model, data)
    H = np.zeros((robot.model.nv, robot.model.nv))
    mujoco.mj_fullM(robot.model, data, H)
    keep = np.r_[0:6, 6 + slides : robot.model.nv]
    return H[np.ix_(keep, keep)]


def test_liquid_at_rest_changes_nothing():
    """Mass matrix of base and joints, the liquid held: the same as of the rigid base."""
    q = CASE.spline.evaluate(7.0)[0]
    rigid = Robot.load(URDF, "tool", base=BASE)
    filled = Robot.load(URDF, "tool", base=BASE, slosh=TANKS)
    assert len(filled.slides) == 6
    winged = Robot.load(URDF, "tool", base=BASE, panels=[PANEL])
    assert np.allclose(mass_matrix(winged, q), mass_matrix(rigid, q), rtol=1e-9, atol=1e-6)
    assert np.allclose(mass_matrix(filled, q), mass_matrix(rigid, q), rtol=1e-9, atol=1e-6)
    assert np.allclose(filled.tool_poses(q[None])[0], rigid.tool_poses(q[None])[0])


def test_a_base_lighter_than_its_liquid_is_refused():
    heavy = SloshMass(
        mass_kg=1000.0, place_m=(0, 0, 0), frequency_hz=1.0, damping_ratio=0.1, stroke_m=0.1
    )
    with pytest.raises(ValueError, match="outweigh"):
        without(BASE, [heavy])
    far = SloshMass(
        mass_kg=50.0, place_m=(9, 0, 0), frequency_hz=1.0, damping_ratio=0.1, stroke_m=0.1
    )
    with pytest.raises(ValueError, match="moments"):
        without(BASE, [far])


def pushed(frequency_hz: float, force_n: float, end_s: float, stroke_m: float = 1.0) -> Any:
    """One mass on one slide at the whole's centre of mass; a push of 0.2 s on the base."""
    rigid = Robot.load(URDF, "tool", base=BASE)
    data = mujoco.MjData(rigid.model)
    q0 = CASE.spline.control_points_rad[0]
    data.qpos[7:] = q0
    mujoco.mj_forward(rigid.model, data)
    centre = data.subtree_com[0].copy()
    tank = SloshMass(
        mass_kg=50.0,
        place_m=tuple(centre),
        axes=((1.0, 0.0, 0.0),),
        frequency_hz=frequency_hz,
        damping_ratio=1e-6,
        stroke_m=stroke_m,
    )
    robot = Robot.load(URDF, "tool", base=BASE, slosh=[tank])
    spline = CASE.spline.scaled(0.0)

    def wrench(t_s: float, data: Any) -> None:
        if t_s < 0.2:
            lever = data.subtree_com[0] - data.xipos[1]
            data.xfrc_applied[1] = [force_n, 0, 0, *np.cross(lever, [force_n, 0, 0])]

    return robot, simulate(robot, spline, 0.0, end_s, 0.005, wrench=wrench)


def test_the_liquid_swings_at_the_two_bodies_frequency():
    """w^2 = k (1/m + 1/M), k = m (2 pi f)^2."""
    robot, history = pushed(0.4, 5.0, 12.0)
    x = history.liquid_m[:, 0]
    rising = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    period = np.diff(history.t_s[rising]).mean()
    rest = robot.model.body_mass.sum() - 50.0
    assert 1 / period == pytest.approx(0.4 * np.sqrt(1 + 50.0 / rest), rel=5e-3)


def test_the_wall_stops_the_liquid():
    _, history = pushed(0.02, 200.0, 8.0, stroke_m=0.02)
    x = np.abs(history.liquid_m[:, 0])
    assert 0.02 < x.max() < 0.05


def test_momentum_stays_zero_with_liquid():
    """The centre of mass does not move while the arm does and the liquid follows late."""
    robot = Robot.load(URDF, "tool", base=BASE, slosh=TANKS)
    history = simulate(robot, CASE.spline, 0.0, 20.0, 0.01)
    assert np.abs(history.liquid_m).max() > 1e-3
    data = mujoco.MjData(robot.model)
    centres = []
    for k in (0, 900, 1500, 2000):
        data.qpos[:] = np.concatenate(
            [history.p_N[k], history.quat_wxyz[k], history.liquid_m[k], history.q[k]]
        )
        mujoco.mj_forward(robot.model, data)
        centres.append(data.subtree_com[0].copy())
    assert np.abs(np.array(centres) - centres[0]).max() < 1e-8


def test_a_panel_swings_at_the_frequency_of_the_free_base():
    """w^2 = K / (I - s^T H^-1 s), I about the hinge; coupling s with base and locked arm, H."""
    q = CASE.spline.control_points_rad[0]
    H = mass_matrix(Robot.load(URDF, "tool", base=BASE), q)[:6, :6]
    a, c, m = np.array([1.0, 0.0, 0.0]), np.array(PANEL.com_m), PANEL.mass_kg
    spin = np.diag([18.75, 22.8, 4.08]) @ a
    momentum = m * np.cross(a, c)
    s = np.concatenate([momentum, spin + np.cross(np.add(PANEL.place_m, c), momentum)])
    inertia = a @ spin + np.cross(a, c) @ momentum
    free = 0.5 * np.sqrt(inertia / (inertia - s @ np.linalg.solve(H, s)))

    def wrench(t_s: float, data: Any) -> None:
        if t_s < 0.2:
            data.xfrc_applied[1, 3] = 5.0

    robot = Robot.load(URDF, "tool", base=BASE, panels=[PANEL])
    history = simulate(robot, CASE.spline.scaled(0.0), 0.0, 12.0, 0.005, wrench=wrench)
    angle = history.liquid_m[200:, 0]
    rising = np.flatnonzero((angle[:-1] < 0) & (angle[1:] >= 0))
    assert 1.0 / (np.diff(history.t_s[rising]).mean()) == pytest.approx(free, rel=5e-3)
    assert free > 0.52
