"""What crosses to the second truth's engine weighs and reaches as the scenario's robot does."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.basilisk.craft import job_of, on_lines, truth_of
from hil.run import bench
from hil.world.history import TruthHistory
from hil.world.scenario import ScenarioError, load
from hil.world.spline import JointSpline


def planned(name: str) -> tuple:
    scenario = on_lines(load(name))
    robot = bench.robot_of(scenario)
    motion = JointSpline.load(scenario.identification)
    return (
        scenario,
        robot,
        bench.truth_of(scenario, robot, JointSpline(1.0, motion.control_points_rad)),
    )


@pytest.mark.parametrize(
    "name", ["target_leo", "two_payloads", "base_slosh", "panel_leo", "wheels_leo"]
)
def test_the_craft_has_the_mass_and_centre_of_mujocos_model(name):
    scenario, robot, plan = planned(name)
    about = json.loads(job_of(scenario, robot, plan)["about"])
    hub = about["hub"]
    parts = [(hub["mass_kg"], np.array(hub["com_m"]))]
    parts += [(part["mass_kg"], np.array(part["place_m"])) for part in about["slides"]]
    for chain in [*about["chains"], *([panel] for panel in about["panels"])]:
        R, p = np.eye(3), np.zeros(3)
        for link in chain:
            p = p + R @ np.array(link["p_PS_P_m"])
            turned = Rotation.from_rotvec(link["q_rad"] * np.array(link["axis"])).as_matrix()
            R = R @ np.array(link["R_PS"]) @ turned
            parts.append((link["mass_kg"], p + R @ np.array(link["com_m"])))
    mass = sum(m for m, _ in parts)
    data = mujoco.MjData(robot.model)
    data.qpos[-robot.n :] = plan.q[0]
    mujoco.mj_kinematics(robot.model, data)
    mujoco.mj_comPos(robot.model, data)
    assert mass == pytest.approx(robot.model.body_mass.sum(), rel=1e-12)
    centre = np.sum([m * c for m, c in parts], axis=0) / mass
    assert np.abs(centre - data.subtree_com[0]).max() < 1e-12


def test_a_flown_state_becomes_a_truth_in_the_order_of_the_robots_joints():
    scenario, robot, plan = planned("two_arms")
    job = job_of(scenario, robot, plan)
    steps = len(job["tau_nm"])
    times = 1e-3 * np.arange(steps + 1)[:, None]
    base = np.zeros((steps + 1, 12))
    base[:, 6:9] = np.tan(0.25 * 0.2 * times) * [0.0, 0.0, 1.0]  # turning about z at 0.2 rad/s
    base[:, 11] = 0.2
    arms = [np.hstack([k + times**2 + np.zeros(7), 2 * times + np.zeros(7)]) for k in (1.0, 2.0)]
    flown = {"state": np.hstack([base, *arms]), "tau_nm": np.tile(times[1:] - 5e-4, 14)}
    truth = truth_of(job, flown, plan.start_s)
    state = truth.at(plan.start_s + 0.5)
    assert state.q == pytest.approx(np.repeat([1.25, 2.25], 7))
    assert state.qd == pytest.approx(np.ones(14))
    assert state.qdd == pytest.approx(2.0 * np.ones(14))
    assert state.tau == pytest.approx(0.5 * np.ones(14))  # of the node between two steps
    assert Rotation.from_matrix(state.R_NB).as_rotvec() == pytest.approx([0.0, 0.0, 0.1])


def test_what_the_second_truth_does_not_fly_is_refused():
    for name in ("bench_target", "target_leo_orbit"):
        scenario = load(name)
        with pytest.raises(ScenarioError, match="neither environment nor stand"):
            job_of(scenario, None, None)


def test_a_truth_is_kept_to_the_bit_and_for_its_scenario_alone(tmp_path):
    scenario, _robot, plan = planned("wheels_leo")
    plan.save(tmp_path / "truth.npz", "wheels_leo")
    again, name = TruthHistory.load(tmp_path / "truth.npz")
    assert name == "wheels_leo"
    assert np.array_equal(again.at(0.3).tau, plan.at(0.3).tau)
    assert np.array_equal(again.wheels_at(0.3), plan.wheels_at(0.3))
    for wrong, words in ((load("target_leo"), "not of target_leo"), (scenario, "covers -4 to 2")):
        with pytest.raises(ScenarioError, match=words):
            bench.prepare(wrong, 0, tmp_path, truth=tmp_path / "truth.npz")
    (tmp_path / "no.npz").write_bytes(b"no")
    with pytest.raises(ScenarioError, match=r"no\.npz"):
        bench.prepare(scenario, 0, tmp_path, truth=tmp_path / "no.npz")
    with pytest.raises(ValueError, match="field"):
        replace(plan, field=object()).save(tmp_path / "field.npz", "any")
