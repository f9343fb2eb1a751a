"""Two arms on two buses: what one carries is found while both move."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag

from fsw.estimators.model.inertia import report_jacobian, to_parameters
from hil.judge import judgement
from hil.run import bench
from hil.world.scenario import load
from planner import criteria, spline
from planner.foreseen import foreseen_root
from planner.subject import build_subject
from tests.support.short_cases import NoMeter, short

CHI2_10_999 = 29.6  # 99.9 % bound of chi-squared with 10 degrees of freedom
CHI2_30_999 = 59.7  # with 30


def prepared(folder: Path, name: str) -> bench.Setup:
    return bench.prepare(short(folder, name=name, points=8), 1, folder)


def judged(folder: Path, name: str) -> tuple[dict, bench.Recorded]:
    setup = prepared(folder, name)
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    return judgement.judge(setup, judgement.make_case(setup), recorded), recorded


def test_the_target_of_one_arm_is_found_while_both_move(tmp_path):
    outcome, recorded = judged(tmp_path, "two_arms")
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < CHI2_10_999
    truth, mass = outcome["truth"]["target"]["mass_kg"], outcome["estimate"]["target"]["mass_kg"]
    assert abs(mass / truth - 1) < 0.01
    for bus in ("left", "right"):
        counters = recorded.status["samples"][bus]
        assert counters["accepted"] > 0
        assert counters["lost"] == counters["late"] == counters["rejected"] == 0


def predicted(setup: bench.Setup) -> np.ndarray:
    """Return the covariance of the reported quantities that a plan of the motion promises."""
    own = build_subject(setup.config)
    reports = [setup.scenario.truth[body] for body in own.problem.unknown]
    x = np.concatenate([to_parameters(r[0], r[1:4], r[4:]) for r in reports])
    T = block_diag(*(report_jacobian(x[own.problem.body(b)]) for b in own.problem.unknown))
    known = own.problem.prior.at(np.concatenate([x, own.problem.prior_mean[len(x) :]]))
    own = replace(own, x=x, state_covariance=known.covariance(), scale=replace(own.scale, T=T))
    root = foreseen_root(own, spline.load(setup.scenario.identification))
    return criteria.report_covariance(root, own.scale)


def test_the_target_is_found_while_four_wheels_hold_a_light_base(tmp_path):
    outcome, recorded = judged(tmp_path, "dual_arm")
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < CHI2_10_999
    assert all(c["lost"] == c["late"] == 0 for c in recorded.status["samples"].values())
    promised = np.sqrt(np.diag(predicted(prepared(tmp_path, "dual_arm"))))
    sigma = outcome["sigma"]["target"]
    found = np.array([sigma["mass_kg"], *sigma["com_m"], *sigma["inertia_kg_m2"]]) / promised
    assert 0.85 < found.min() < found.max() < 1.15


def test_base_target_and_a_payload_of_the_other_arm_are_found_together(tmp_path):
    outcome, _ = judged(tmp_path, "two_payloads")
    assert outcome["valid"], outcome["reason"]
    assert list(outcome["estimate"]) == ["base", "target", "right_payload"]
    assert outcome["nees"] < CHI2_30_999


def test_an_arm_without_torque_sensors_takes_part(tmp_path):
    """The base feels the right arm; its torques are nobody's to measure."""
    scenario = short(tmp_path, name="two_arms", points=8)
    joints = dict(scenario.sensors["joints"])
    joints["nodes"] = [node | {"torque_sensor": node["bus"] == "left"} for node in joints["nodes"]]
    scenario = replace(scenario, sensors=scenario.sensors | {"joints": joints})
    setup = bench.prepare(scenario, 1, tmp_path)
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    outcome = judgement.judge(setup, judgement.make_case(setup), recorded)
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < CHI2_10_999
    assert not any(block.has_joint[7:].any() for block in recorded.blocks)
    assert all(block.has_joint[:7].all() for block in recorded.blocks)
    assert not [event for event in recorded.events if "TORQUE" in event.code]


def test_each_arm_has_its_own_bus(tmp_path):
    setup = bench.prepare(load("two_arms"), 1, tmp_path)
    assert {bus.name: bus.port for bus in setup.config.buses} == {"left": 43113, "right": 43114}
    assert all(joint.name.startswith(joint.bus) for joint in setup.config.joints)
