"""The environment on the truth: what it loads, what it leaves alone, what sensors see of it."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
import pytest

from hil.devices.plant import Plant
from hil.run.flight import flight_document
from hil.world.environment.config import EnvironmentSection
from hil.world.environment.wrench import Environment
from hil.world.history import TruthHistory
from hil.world.scenario import ScenarioError, load
from hil.world.sensors import rotation_of, specific_force
from hil.world.simulation import simulate_in
from tests.support.plant_cases import sensor_config
from tests.support.truth_cases import stand_in

ANGLE_RAD = 2.6  # in sunlight at the default epoch
LEO = {"orbit": {"altitude_m": 500e3, "latitude_argument_rad": ANGLE_RAD}}
AIR = {"atmosphere": {"density_kg_m3": 1e-11}}
LIGHT: dict[str, Any] = {"solar_pressure": {}}
CASE = stand_in("target_leo")
T_S = 12.0


def section(**parts: Any) -> EnvironmentSection:
    return EnvironmentSection.from_dict(LEO | parts)


@lru_cache(maxsize=8)
def history(kind: str) -> TruthHistory:
    parts = {
        "none": None,
        "gradient": section(gravity_gradient=True),
        "third": section(third_body=True),
        "air": section(**AIR),
        "light": section(**LIGHT),
    }
    return simulate_in(parts[kind], CASE.robot, CASE.spline, 0.0, T_S, 0.01)


def applied(parts: EnvironmentSection, t_s: float = 5.0) -> tuple[np.ndarray, Any]:
    """Wrench per body in one arm pose of a robot turned in space."""
    model = CASE.robot.model
    data = mujoco.MjData(model)
    data.qpos[3:7] = [0.5, 0.5, -0.5, 0.5]
    data.qpos[7:] = CASE.spline.evaluate(t_s)[0]
    mujoco.mj_forward(model, data)
    Environment(parts, CASE.robot, 0.0, 10.0)(t_s, data)
    return data.xfrc_applied.copy(), data


def test_each_part_acts_alone_and_they_add_up():
    parts = [
        {"gravity_gradient": True},
        {"third_body": True},
        AIR,
        LIGHT,
    ]
    alone = [applied(section(**part))[0] for part in parts]
    together = applied(section(**{k: v for part in parts for k, v in part.items()}))[0]
    assert all(np.abs(one).max() > 0 for one in alone)
    assert np.allclose(sum(alone), together, rtol=1e-9, atol=1e-18)
    assert not applied(section())[0].any()


def test_the_gradient_is_that_of_every_body():
    """Written out from the point-mass expansion with numpy, body by body."""
    found, data = applied(section(gravity_gradient=True))
    model = CASE.robot.model
    rate2 = 3.986004418e14 / 6_878_137.0**3
    angle = ANGLE_RAD + rate2**0.5 * 5.0
    up = np.array([np.cos(angle), np.sin(angle), 0.0])
    centre = model.body_mass @ data.xipos / model.body_mass.sum()
    for body in range(1, model.nbody):
        d, R = data.xipos[body] - centre, data.ximat[body].reshape(3, 3)
        inertia = R @ np.diag(model.body_inertia[body]) @ R.T
        force = model.body_mass[body] * rate2 * (3 * (up @ d) * up - d)
        torque = 3 * rate2 * np.cross(up, inertia @ up)
        assert np.allclose(found[body], [*force, *torque], rtol=1e-9, atol=1e-16)


def test_plates_push_base_and_target_alone():
    for part in (AIR, LIGHT):
        found = applied(section(**part))[0]
        pushed = np.flatnonzero(found.any(axis=1))
        assert pushed.tolist() == [1, CASE.robot.model.nbody - 1]


def test_drag_on_the_base_is_area_times_pressure():
    """Face of 1.5 x 3.0 m in the wind (C_d 2.26 of the cube): the wind lies in the plane x, y."""
    found = applied(section(**AIR))[0][1, :3]
    v = 7111.0
    angle = ANGLE_RAD + 5.0 * 1.1068e-3
    wind = -v * np.array([-np.sin(angle), np.cos(angle), 0.0])
    along = found @ wind / v
    # base axes are turned by 120 deg: faces of 4.5, 4.5 and 2.25 m^2 meet the wind obliquely
    assert 0.5 * 1e-11 * v**2 * 2.25 * 2.0 < along < 0.5 * 1e-11 * v**2 * 6.4 * 2.5


def test_given_surfaces_are_used():
    small = section(**AIR, surfaces={"target": {"size_m": [0.1, 0.1, 0.1]}})
    ratio = applied(small)[0][-1, :3] / applied(section(**AIR))[0][-1, :3]
    assert np.allclose(ratio[:2], 0.01 / 3.75, rtol=1e-6)
    shifted = section(**AIR, surfaces={"base": {"centre_m": [0.0, 0.0, 0.0]}})
    assert np.abs(applied(section(**AIR))[0][1, 3:]).max() < 1e-15
    assert np.abs(applied(shifted)[0][1, 3:]).max() > 1e-5


def test_the_gradient_loads_joints_and_turns_the_whole():
    plain, pulled = history("none").at(T_S - 1), history("gradient").at(T_S - 1)
    assert 1e-4 < np.abs(pulled.tau - plain.tau).max() < 1e-1
    assert np.abs(pulled.w_NB_B - plain.w_NB_B).max() > 1e-6


def test_sun_and_moon_leave_joints_and_accelerometer_alone():
    """The kinematic reading sees them, specific force and torque do not."""
    t = np.arange(1.0, T_S, 1.0)
    plain, pulled = history("none").at(t), history("third").at(t)
    R = rotation_of((0.0, 0.0, 0.0, 1.0))
    place = (0.3, -0.2, 0.1)
    felt = specific_force(pulled, place, R) - specific_force(plain, place, R)
    seen = specific_force(pulled, place, R, "kinematic") - specific_force(plain, place, R)
    assert np.abs(pulled.tau - plain.tau).max() < 1e-9
    assert np.abs(felt).max() < 1e-11
    assert np.linalg.norm(seen, axis=1).min() > 1e-7


def test_the_accelerometer_feels_the_field_where_it_sits():
    """At the centre of mass gravity's gradient vanishes; elsewhere f = a - G (p - c)."""
    state = history("gradient").at(np.array([5.0]))
    R, up_angle = state.R_NB[0], ANGLE_RAD + 1.1068e-3 * 5.0
    up = R.T @ np.array([np.cos(up_angle), np.sin(up_angle), 0.0])
    G = 1.2251e-6 * (3 * np.outer(up, up) - np.eye(3))
    assert np.allclose(state.gradient_B[0], G, rtol=1e-3, atol=1e-10)
    centre = np.linalg.solve(state.gradient_B[0], -state.g_NB_B[0])  # where the field is zero
    still = replace(state, w_NB_B=np.zeros((1, 3)), wd_NB_B=np.zeros((1, 3)))
    felt = specific_force(still, tuple(centre), np.eye(3))
    assert np.allclose(felt, state.a_NB_B, atol=1e-12)
    model, data = CASE.robot.model, mujoco.MjData(CASE.robot.model)
    data.qpos[7:] = state.q[0]
    mujoco.mj_kinematics(model, data)
    assert np.allclose(centre, model.body_mass @ data.xipos / model.body_mass.sum(), atol=1e-6)


def test_air_slows_the_whole_by_its_force():
    """Momentum gained is force times time."""
    pushed, plain = history("air").at([T_S]), history("none").at([T_S])
    env = Environment(section(**AIR), CASE.robot, 0.0, T_S)
    data = mujoco.MjData(CASE.robot.model)
    mujoco.mj_kinematics(CASE.robot.model, data)
    env(0.0, data)
    force = data.xfrc_applied[:, :3].sum(axis=0)
    gained = CASE.robot.model.body_mass.sum() * (pushed.v_NB_N - plain.v_NB_N)[0]
    # the faces turn by a few degrees, and the base turns about the centre of mass
    assert gained @ force / np.linalg.norm(force) == pytest.approx(
        T_S * np.linalg.norm(force), rel=0.15
    )


def test_devices_take_a_history_with_an_environment():
    plant = Plant(history("gradient"), sensor_config(), 1)
    assert plant.imu is not None
    assert plant.imu.take(int(5e8))


def test_a_scenario_names_its_environment_and_the_flight_side_its_orbit(tmp_path):
    scenario = load("target_leo_orbit")
    names = tuple(f"joint{k}" for k in range(1, 8))
    document = flight_document(scenario, {}, names, tmp_path, {"arm": 1}, {})
    position = np.array(document["orbit"]["position_m"])
    angle = 0.6 - scenario.before_s * 1.1068e-3
    assert np.allclose(position, 6_878_137 * np.array([np.cos(angle), np.sin(angle), 0]), rtol=1e-4)
    silent = replace(
        scenario, environment=scenario.environment.model_copy(update={"told_to_flight": False})
    )
    assert "orbit" not in flight_document(silent, {}, names, tmp_path, {"arm": 1}, {})


def test_a_wrong_key_is_named(tmp_path):
    text = (load_path := (load("target_leo").urdf.parents[1] / "scenarios")) / "target_leo.yaml"
    wrong = text.read_text(encoding="utf-8").replace("../", f"{load_path.parent}/")
    wrong = wrong.replace("common/", f"{load_path}/common/")
    path = tmp_path / "wrong.yaml"
    path.write_text(wrong + "environment: {orbit: {height_m: 3.0}}\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"orbit.height_m: unknown key.*altitude_m: missing"):
        load(str(path))
