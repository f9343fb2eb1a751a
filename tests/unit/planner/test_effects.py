"""Which effects have a cost, where their size is declared, and what they do in closed form."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from fsw.checks.configuration import validate
from fsw.config import Config
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.robot import RobotModel
from planner import left_out
from planner.effects import LOW_ORBIT_RAD_S, Cost, costs, told
from planner.nominal import nominal_motion
from planner.spline import Trajectory
from tests.support.estimator_cases import URDF, make_config, robot_model
from tests.support.excitation_cases import subject
from tests.support.mode_cases import PANEL, TANK, config_with_modes, mode_settings

WHEEL = {
    "bus": "arm",
    "rate_hz": 50.0,
    "inertia_kg_m2": 0.1,
    "speed_limit_rad_s": 600.0,
    "speed_noise_rad_s": 0.01,
}


def changed(config: Config, **sections: Any) -> Config:
    return Config.model_validate(config.model_dump() | sections)


def wheels(torque_limit_nm: float) -> list[dict[str, Any]]:
    return [
        WHEEL
        | {
            "name": f"wheel{k}",
            "node_id": 0x21 + k,
            "axis_B": np.eye(3)[k].tolist(),
            "torque_limit_nm": torque_limit_nm,
        }
        for k in range(3)
    ]


def cost_of(config: Config, key: str, model: RobotModel | None = None) -> Cost:
    own = model or robot_model()
    problem = build_problem(config, own, exact=config.estimator.is_regression)
    found = costs(config, problem, nominal_motion(config, own))
    return next(cost for cost in found if cost.key == key)


def test_friction_of_the_urdf_that_no_state_knows_is_ignored_and_has_a_cost(tmp_path: Path):
    text = URDF.read_text()
    at = text.index("</joint>")
    path = tmp_path / "rough.urdf"
    path.write_text(text[:at] + '<dynamics friction="0.4"/>' + text[at:])
    config = make_config()
    cost = cost_of(config, "joints[].friction_coulomb_sigma_nm", RobotModel(path, "tool"))
    assert not cost.is_modelled
    assert cost.effect == "Coulomb friction, 0.4 N m"
    assert cost.sigmas[0] > 1.0
    half = text[:at] + '<dynamics friction="0.2"/>' + text[at:]
    path.write_text(half)
    less = cost_of(config, "joints[].friction_coulomb_sigma_nm", RobotModel(path, "tool"))
    assert less.mass_kg[0] == pytest.approx(0.5 * cost.mass_kg[0], rel=1e-6)


def test_what_a_regression_takes_as_exact_is_ignored_with_the_size_it_is_declared_with():
    config = make_config(doubt=True, method="mrnea", weighting="ols")
    for key in ("robot.links_sigma_ratio", "joints[].zero_sigma_rad"):
        assert not cost_of(config, key).is_modelled
    fused = make_config(doubt=True)
    assert cost_of(fused, "robot.links_sigma_ratio").is_modelled


def test_an_orbit_that_is_not_told_is_ignored_and_has_its_size_by_pinocchio() -> None:
    config = subject("base").config
    problem, _ = validate(config)
    lines = told(config, problem, None)
    gradient = next(line for line in lines if line.startswith("gravity gradient"))
    assert "(orbit): ignored; may cost" in gradient
    model = pin.buildModelFromUrdf(
        str(config.resolve(config.robot.urdf)), pin.JointModelFreeFlyer()
    )
    base = config.bodies["base"]
    xx, xy, xz, yy, yz, zz = base.inertia_kg_m2
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    model.inertias[1] = pin.Inertia(base.mass_kg, np.array(base.com_m), inertia)
    data, q = model.createData(), pin.neutral(model)
    q[7:] = nominal_motion(config, problem.model).points_rad[0]
    pin.ccrba(model, data, q, np.zeros(model.nv))
    moments = np.linalg.eigvalsh(data.Ig.inertia)
    expected = 1.5 * LOW_ORBIT_RAD_S**2 * (moments[-1] - moments[0])
    found = float(gradient.split("up to ")[1].split(" ")[0])
    np.testing.assert_allclose(found, expected, rtol=0.05)
    for word in ("wheels", "thrusters", "modes", "robot.links_sigma_ratio"):
        assert not any(f"({word})" in line for line in lines[:-1])
        assert f"({word})" in lines[-1]
    assert lines[-1].startswith("no size declared, so no cost: ")
    for kind in ("inertia of wheels", "force of thrusters", "walks", "bias of gyro"):
        assert kind not in lines[-1]  # what the robot has not, and what is declared


def test_strong_wheels_hold_the_base_still_and_weak_ones_pull_with_their_limit():
    for limit_nm in (1e3, 0.05):
        config = changed(make_config(momentum_sigma_nms=5.0), wheels=wheels(limit_nm))
        problem = build_problem(config, robot_model())
        motion = nominal_motion(config, problem.model)
        free = left_out.blocks_along(config, problem, motion)
        held = left_out.held(free, problem)
        rates = [
            np.abs([own[:, -3:] for own in left_out.channels(blocks, problem)]).max()
            for blocks in (free, held)
        ]
        most_nm = max(np.abs(block.carried_nm).max() for block in held)
        if limit_nm > 1.0:
            assert rates[1] < 0.02 * rates[0]
        else:
            assert most_nm == limit_nm


def test_the_nominal_motion_keeps_ranges_and_speed_limits():
    config = make_config()
    model = robot_model()
    motion: Trajectory = nominal_motion(config, model)
    q, qd = motion.evaluate(np.linspace(0.0, motion.duration_s, 2001))[:2]
    limits = [joint.speed_limit_rad_s for joint in config.joints]
    assert np.all(np.abs(qd) <= limits)
    assert np.all(q >= model.model.lowerPositionLimit[7:])
    assert np.all(q <= model.model.upperPositionLimit[7:])
    assert np.ptp(q, axis=0).min() > 0.1
    np.testing.assert_allclose(qd[[0, -1]], 0.0, atol=1e-9)


def test_a_motion_in_which_nothing_moves_tells_no_mass_and_so_no_cost():
    config = make_config()
    problem = build_problem(config, robot_model())
    still = nominal_motion(config, problem.model).scaled(0.0)
    lines = told(config, problem, still)
    assert lines[1] == "none: this motion does not determine the mass of target"
    assert not any("would cost" in line or "may cost" in line for line in lines)


def test_every_mode_has_a_cost_of_its_own_and_the_amplitudes_their_units():
    modes = [mode_settings(PANEL), mode_settings(TANK), mode_settings(TANK, name="small")]
    modes[2] |= {"mass_kg": 5.0, "amplitude_m": 2e-3}
    config = config_with_modes(modes=modes)
    problem = build_problem(config, robot_model())
    motion = replace(nominal_motion(config, problem.model), duration_s=4.0)
    found = {cost.effect: cost for cost in costs(config, problem, motion)}
    told_of = "modes that swing already when the motion begins, liquid by 0.005 m, panels by 0.001"
    assert f"{told_of} rad" in found
    own = {effect: cost for effect, cost in found.items() if cost.key == "modes"}
    assert sorted(own) == [
        "mode panel (panel) as the motion drives it, 25 kg",
        "mode small (slosh) as the motion drives it, 5 kg",
        "mode tank (slosh) as the motion drives it, 25 kg",
    ]
    by_name = {effect.split()[1]: cost.mass_kg[0] for effect, cost in own.items()}
    assert 0.0 < by_name["small"] < by_name["tank"]
