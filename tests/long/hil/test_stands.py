"""A robot in a laboratory: the base clamped, or on an air-bearing table; gravity; its truth."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from hil.judge import judgement
from hil.run import bench
from hil.world.scenario import load
from hil.world.sensor_config import SensorConfig
from hil.world.sensors import JointErrors
from hil.world.stand import Stand
from hil.world.truth import Body, Robot, simulate
from tests.support.short_cases import NoMeter, short
from tests.support.truth_cases import ROBOTS, pin_model, random_spline

CHI2_10_999 = 29.6  # 99.9 % bound of chi-squared with 10 degrees of freedom
LAB_ARM = ROBOTS / "lab_arm.urdf"
BOX = Body(5.0, (0.03, -0.02, 0.08), (0.03, 0.001, -0.002, 0.035, 0.001, 0.025))


@pytest.mark.parametrize("motion", ["clamped", "planar"])
def test_another_engine_gives_the_torques_and_a_wrench_that_the_stand_alone_bears(motion):
    """Inverse dynamics under gravity: no force along what is free, the torques as in the truth."""
    robot = Robot.load(LAB_ARM, "tool", target=BOX)
    model = pin_model(LAB_ARM, BOX)
    spline = random_spline(7, 3, np.array([0.2, 0.8, 0.0, -0.8, 0.1, 0.5, 0.0]))
    history = simulate(robot, spline, -1.0, 21.0, stand=Stand(motion=motion))
    state = history.at(np.linspace(0.5, 19.5, 40))
    data = model.createData()
    model.gravity.linear = np.array([0.0, 0.0, -9.80665])
    for k in range(len(state.t_s)):
        R = state.R_NB[k]
        q = np.concatenate([state.p_NB_N[k], state.q_NB_xyzw[k], state.q[k]])
        v = np.concatenate([R.T @ state.v_NB_N[k], state.w_NB_B[k], state.qd[k]])
        spatial = state.a_NB_B[k] - np.cross(state.w_NB_B[k], v[:3])
        a = np.concatenate([spatial, state.wd_NB_B[k], state.qdd[k]])
        wrench = pin.rnea(model, data, q, v, a)
        assert np.abs(wrench[6:] - state.tau[k]).max() <= 1e-6 * np.abs(state.tau).max()
        if motion == "planar":
            assert np.abs(wrench[[0, 1, 5]]).max() <= 1e-5
    assert np.abs(state.g_NB_B - [0.0, 0.0, -9.80665]).max() <= 1e-12
    moved = np.abs(np.hstack([state.p_NB_N, state.w_NB_B])).max(axis=0) > 1e-9
    free = [True, True, False, False, False, True] if motion == "planar" else [False] * 6
    assert moved.tolist() == free


def test_a_clamped_base_does_without_an_inertial_unit(tmp_path):
    scenario = short(tmp_path, name="bench_target", points=12)
    sensors = load("bench_target").sensors | {"imu": None, "star_tracker": None}
    setup = bench.prepare(replace(scenario, sensors=sensors), 3, tmp_path)
    assert not setup.config.imu.present
    assert "imu" not in (tmp_path / "flight.yaml").read_text()
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    outcome = judgement.judge(setup, judgement.make_case(setup), recorded)
    assert outcome["nees"] < CHI2_10_999
    assert abs(outcome["estimate"]["target"]["mass_kg"] / 5.0 - 1) < 0.001
    assert not [event for event in recorded.events if event.severity in ("medium", "high")]


@pytest.mark.parametrize("name", ["bench_target", "table_target"])
def test_the_payload_is_found_within_its_own_uncertainty(tmp_path, name):
    scenario = replace(short(tmp_path, name=name, points=12), sensors=load(name).sensors)
    setup = bench.prepare(scenario, 2, tmp_path)
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    outcome = judgement.judge(setup, judgement.make_case(setup), recorded)
    assert outcome["nees"] < CHI2_10_999
    mass = outcome["estimate"]["target"]["mass_kg"]
    assert abs(mass / 5.0 - 1) < 0.001
    assert outcome["mass_sigma_to_crb_ratio"]["target"] < 1.3


def test_the_payload_is_found_from_motor_currents(tmp_path):
    """Gear friction, rotor inertia, ripple and a wrong gain are in the plant's torques only."""
    name = "bench_current"
    scenario = replace(short(tmp_path, name=name, points=12), sensors=load(name).sensors)
    setup = bench.prepare(scenario, 2, tmp_path)
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    outcome = judgement.judge(setup, judgement.make_case(setup), recorded)
    assert outcome["nees"] < CHI2_10_999
    sensors = SensorConfig.from_dict(scenario.sensors).joints
    motors = JointErrors(sensors, 7, setup.seed).motor_side
    found = recorded.estimates[-1]
    own = [k for k, state in enumerate(found.names) if state.startswith("rotor_inertia")]
    error = found.mean[own] - motors.rotor_inertia_kg_m2
    z = error / np.sqrt(np.diag(found.covariance))[own]
    assert np.abs(z).max() < 4.0
    assert z @ z < CHI2_10_999
