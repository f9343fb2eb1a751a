"""Reaction wheels: MuJoCo's truth, the estimate from samples and from device bytes, left out."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from fsw.config import Config
from fsw.estimators.batch.run import run_batch
from fsw.estimators.conditioning.polynomial import gauss_nodes
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.building import build_problem
from fsw.messages import Block
from hil.judge import judgement
from hil.run import bench
from hil.world.history import TruthHistory
from hil.world.robot import Robot, without
from hil.world.scenario import Scenario, load
from hil.world.truth import simulate
from tests.support.estimator_cases import (
    BASE,
    NODES,
    TARGET,
    URDF,
    WINDOW_S,
    make_config,
    parameters,
    robot_model,
    true_block,
    wrong,
)
from tests.support.one_block import mrnea_rows
from tests.support.short_cases import NoMeter, short
from tests.support.truth_cases import stand_in

CHI2_10_999 = 29.6  # 99.9 % bound of chi-squared with 10 degrees of freedom
SYSTEM = load("wheels_leo").wheels
assert SYSTEM is not None
AXES, INERTIAS = SYSTEM.axes, SYSTEM.inertias_kg_m2


@lru_cache(maxsize=1)
def flight() -> tuple[Robot, TruthHistory]:
    robot = Robot.load(URDF, "tool", base=BASE, target=TARGET, wheels=SYSTEM)
    return robot, simulate(robot, stand_in("target_leo").spline, 0.0, 16.0, 0.005)


def mass_matrix(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Mass matrix of base and joints, the wheels locked."""
    data, nv = mujoco.MjData(robot.model), robot.model.nv
    data.qpos[-len(q) :] = q
    mujoco.mj_forward(robot.model, data)
    H = np.zeros((nv, nv))
    mujoco.mj_fullM(robot.model, data, H)
    keep = np.r_[0:6, nv - len(q) : nv]
    return H[np.ix_(keep, keep)]


def test_locked_wheels_change_nothing() -> None:
    plain = Robot.load(URDF, "tool", base=BASE, target=TARGET)
    q = stand_in("target_leo").spline.evaluate(7.0)[0]
    assert np.allclose(mass_matrix(flight()[0], q), mass_matrix(plain, q), rtol=1e-9, atol=1e-7)


def test_wheels_heavier_than_the_base_are_refused() -> None:
    assert SYSTEM is not None
    heavy = replace(SYSTEM, rotors=tuple(replace(r, mass_kg=300.0) for r in SYSTEM.rotors))
    with pytest.raises(ValueError, match="outweigh"):
        without(BASE, (), heavy)


def test_the_momentum_of_base_arm_and_wheels_is_kept_by_mujoco_and_by_the_closed_form() -> None:
    """MuJoCo's own sum over bodies is constant; sum a J speed plus the locked rest is the same."""
    robot, history = flight()
    plain = Robot.load(URDF, "tool", base=BASE, target=TARGET)
    start = AXES @ (INERTIAS * history.wheel_rad_s[0])
    for k in (0, 800, 1600, 3200):
        data = mujoco.MjData(robot.model)
        data.qpos[:7] = np.concatenate([history.p_N[k], history.quat_wxyz[k]])
        data.qpos[11:] = history.q[k]
        data.qvel[:6] = np.concatenate([history.v_N[k], history.w_B[k]])
        data.qvel[6:10], data.qvel[10:] = history.wheel_rad_s[k], history.qd[k]
        mujoco.mj_forward(robot.model, data)
        mujoco.mj_subtreeVel(robot.model, data)
        np.testing.assert_allclose(data.subtree_angmom[0], start, atol=1e-6)
        locked = mujoco.MjData(plain.model)
        locked.qpos[:7], locked.qpos[7:] = data.qpos[:7], history.q[k]
        locked.qvel[:6], locked.qvel[6:] = data.qvel[:6], history.qd[k]
        mujoco.mj_forward(plain.model, locked)
        mujoco.mj_subtreeVel(plain.model, locked)
        R = data.xmat[1].reshape(3, 3)
        h = R @ AXES @ (INERTIAS * history.wheel_rad_s[k])
        np.testing.assert_allclose(locked.subtree_angmom[0] + h, start, atol=1e-6)
    assert np.ptp(history.wheel_rad_s, axis=0).min() > 1.0  # they worked


def test_the_motors_obey_newton_about_the_axes_and_their_limits() -> None:
    assert SYSTEM is not None
    history = flight()[1]
    gained = INERTIAS * (history.wheel_rad_s2 + history.wd_B @ AXES)
    np.testing.assert_allclose(history.motor_nm, gained, atol=1e-9)
    assert np.abs(history.motor_nm).max() <= SYSTEM.torque_limit_nm


def test_the_hold_turns_the_base_back() -> None:
    """A base that turns is slowed, and one off its attitude pushed back: signs of the law."""
    assert SYSTEM is not None
    still = np.zeros(len(INERTIAS))
    for axis in np.eye(3):
        for turned, rate in ((0.01 * axis, 0.0 * axis), (0.0 * axis, 0.001 * axis)):
            on_base = -AXES @ SYSTEM.motor_torque_nm(turned, rate, still)
            assert on_base @ axis < 0
            assert np.allclose(np.cross(on_base, axis), 0.0, atol=1e-12)
    fast = 0.999 * SYSTEM.speed_limit_rad_s * np.ones(len(INERTIAS))
    torque = SYSTEM.motor_torque_nm(np.array([0.3, 0.2, 0.1]), np.zeros(3), fast)
    assert (torque < 0.05 * SYSTEM.torque_limit_nm).all()


def true_blocks(count: int) -> list[Block]:
    """Noise-free blocks of the motion with the wheels that turn."""
    history, blocks = flight()[1], []
    for k in range(count):
        plain = true_block(history, k * WINDOW_S, k)
        t_s = k * WINDOW_S + WINDOW_S / 2 * (1 + gauss_nodes(NODES))
        speed, torque = (
            np.stack(column) for column in zip(*map(history.wheels_at, t_s), strict=True)
        )
        slope = torque - INERTIAS * (plain.wd_NB_B_rad_s2 @ AXES)  # relative to the base
        root = 1e-6 * np.eye(2 * NODES)
        blocks.append(
            replace(
                plain,
                carried_nms=INERTIAS * speed,
                carried_nm=slope,
                cov_carried=np.stack([root] * len(INERTIAS)),
            )
        )
    return blocks


def config(**options: Any) -> Config:
    data = make_config(("target",), biases=False, momentum_sigma_nms=20.0, **options).model_dump()
    data["wheels"] = [
        {
            "name": f"wheel{k + 1}",
            "bus": "arm",
            "node_id": 0x21 + k,
            "rate_hz": 50.0,
            "axis_B": AXES[:, k].tolist(),
            "inertia_kg_m2": float(INERTIAS[k]),
            "speed_limit_rad_s": 700.0,
            "speed_noise_rad_s": 0.01,
            "torque_limit_nm": 2.0,
        }
        for k in range(len(INERTIAS))
    ]
    return Config.model_validate(data)


def test_another_engine_s_motion_leaves_no_residual() -> None:
    """MuJoCo's torques, forces and rates are those predicted from arm and wheels."""
    assert SYSTEM is not None
    problem = build_problem(config(), robot_model())
    x = problem.prior_mean.copy()
    x[problem.body("target")] = parameters(TARGET)
    history = flight()[1]
    x[problem.at("momentum")] = AXES @ (INERTIAS * history.wheel_rad_s[0])
    for block in true_blocks(38)[::6]:
        p = predict(block, x, problem)
        np.testing.assert_allclose(p.tau_nm, block.tau_nm, atol=3e-4)
        np.testing.assert_allclose(p.f_m_s2, block.f_NS_B_m_s2, atol=3e-6)
        np.testing.assert_allclose(p.w_rad_s, block.w_NB_B_rad_s, atol=3e-7)
        assert np.abs(mrnea_rows(block, x, problem, "ols").b).max() < 0.02
        still = replace(
            block, carried_nms=0.0 * block.carried_nms, carried_nm=0.0 * block.carried_nm
        )
        assert np.abs(predict(still, x, problem).w_rad_s - block.w_NB_B_rad_s).max() > 1e-4


@pytest.mark.parametrize("method", ["fused", "mrnea", "rda"])
def test_noise_free_blocks_give_the_target_back(method: str) -> None:
    prior = wrong(TARGET, np.random.default_rng(5))
    found = run_batch(config(target=prior), true_blocks(38), method, ("target",))
    target = found["estimate"]["target"]
    assert target["mass_kg"] == pytest.approx(TARGET.mass_kg, rel=1e-3)
    np.testing.assert_allclose(target["com_m"], TARGET.com_m, atol=1e-3)


def judged(folder: Path, scenario: Scenario, **overrides: Any) -> tuple[dict[str, Any], Any]:
    setup = bench.prepare(scenario, 1, folder)
    if overrides:
        setup = replace(setup, config=setup.config.with_sections(**overrides))
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    titles = {section.title for section in judgement.channel_sections(setup, recorded)}
    assert {"Residuals", "Limits of the accuracy"} <= titles  # by states that are not published
    return judgement.judge(setup, judgement.make_case(setup), recorded), recorded


def with_wheel_sensors(scenario: Scenario, **changes: Any) -> Scenario:
    wheels = scenario.sensors["wheels"] | changes
    return replace(scenario, sensors=scenario.sensors | {"wheels": wheels})


@pytest.mark.parametrize("changes", [{}, {"rate_hz": 2.0, "torque_used": True}], ids=str)
def test_the_target_is_found_while_wheels_hold_the_base(
    tmp_path: Path, changes: dict[str, Any]
) -> None:
    scenario = with_wheel_sensors(short(tmp_path, name="wheels_leo"), **changes)
    outcome, recorded = judged(tmp_path, scenario)
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < CHI2_10_999
    wheels = recorded.status["wheels"]
    assert set(wheels) == {"wheel1", "wheel2", "wheel3", "wheel4"}
    expected = changes.get("rate_hz", 50.0) * recorded.status["ticks"] / 200.0
    for own in wheels.values():
        assert own["accepted"] == pytest.approx(expected, abs=3)
        assert own["rejected"] == 0
    assert wheels["wheel1"]["temperature_degc"] == 25.0 or changes
    assert recorded.status["windows"]["unusable"] <= 1


def test_wheels_left_out_of_the_configuration_are_never_confidently_wrong(tmp_path: Path) -> None:
    outcome, _ = judged(tmp_path, short(tmp_path, name="wheels_leo"), wheels=())
    assert not outcome["valid"] or outcome["nees"] < CHI2_10_999


def test_a_wheel_that_falls_silent_costs_windows_and_is_reported(tmp_path: Path) -> None:
    scenario = short(tmp_path, name="wheels_leo")
    setup = bench.prepare(scenario, 1, tmp_path)
    run = bench.VirtualRun(setup, record=False)
    run.advance(4.0, NoMeter())
    plant = run._plant
    node = next(n for n in plant.segments["arm"].nodes.values() if n.node_id == 0x22)
    node.silent = True
    run.advance(8.0, NoMeter())
    node.silent = False
    run.advance(setup.total_s, NoMeter())
    recorded = run.finish(NoMeter())
    codes = [e.code for e in recorded.events if "wheel2" in e.text]
    assert codes == ["WHEEL_SILENT", "RECOVERED"]
    assert 8 <= recorded.status["windows"]["unusable"] <= 13
