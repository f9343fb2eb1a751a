"""Findings on a prismatic joint name metres, newtons and the keys of its configuration."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from fsw.checks.configuration import _noise_warnings
from fsw.estimators.batch.reference import _remedy
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.model.building import build_problem, robot_of
from fsw.estimators.noise.sensors import SensorNoise
from fsw.messages import ChannelWindow
from offline.checks.mistakes import _friction, _units
from offline.checks.mistakes_of_wires import described_units
from offline.checks.recorded import range_findings, sample_findings
from tests.support.estimator_cases import make_config
from tests.support.sliding import JOINT, sliding_config

KEYS_OF_ANGLES = ("_nm", "_rad", "N m", "degree")


@pytest.fixture
def config(tmp_path):
    return sliding_config(tmp_path, ("target",))


def test_missing_forces_name_the_limit_in_newtons(config):
    t_ns = np.arange(8) * 10**6
    values = np.column_stack([np.zeros(8), np.full(8, np.nan)])
    channel = ChannelWindow(t_ns=t_ns, values=values, missing=False, stale=False)
    joints = tuple([channel] * len(config.joints))
    lines = sample_findings(config, [cast(Any, SimpleNamespace(joints=joints))])
    rail, other = lines[JOINT], lines[0]
    assert "its force is missing in 100 %" in rail
    assert "force_limit_n" in rail
    assert not any(word in rail for word in KEYS_OF_ANGLES)
    assert "torque_limit_nm" in other


def test_samples_beyond_limits_name_the_keys_of_both_kinds(config):
    counts = {"joints": {"received": 100, "reject_range": 50}}
    (line,) = range_findings(config, counts)
    for word in ("force_limit_n", "speed_limit_m_s", "torque_limit_nm", "mm", "degrees"):
        assert word in line
    (line,) = range_findings(make_config(("target",)), counts)
    assert "force_limit_n" not in line
    assert "mm" not in line


def test_friction_and_units_are_asked_for_by_the_keys_of_both_kinds(config):
    (friction,) = _friction(config)
    assert "friction_coulomb_sigma_n and" in friction.text
    assert "friction_coulomb_sigma_nm" in friction.text
    assert any("N, mN" in own.text for own in _units(config))


def test_a_described_rail_may_be_in_another_unit_of_length(config):
    own = [config.joints[k].model_copy(update={"driver": "described"}) for k in (0, JOINT)]
    texts = [mistake.text for mistake in described_units(cast(Any, SimpleNamespace(joints=own)))]
    turning = [text for text in texts if "joints.0.signals.position" in text]
    sliding = [text for text in texts if "joints.1.signals.position" in text]
    assert len(turning) == len(sliding) == 2
    assert "its position is 1e+03 times too large (mm as m?)" in sliding[0]
    assert "its position is 1e+03 times too small (m as mm?)" in sliding[1]
    assert not any(word in text for text in sliding for word in ("deg", "angle"))


def test_the_walk_of_a_rail_is_in_metres(config):
    joint = config.joints[JOINT].model_copy(
        update={"encoder": "speed", "speed_noise_rad_s": 1.0, "start_rad": 0.0}
    )
    joints = (*config.joints[:JOINT], joint, *config.joints[JOINT + 1 :])
    lines = list(_noise_warnings(config.model_copy(update={"joints": joints})))
    (walk,) = [line for line in lines if "walks" in line]
    assert f"joints.{JOINT}.speed_noise_m_s" in walk
    assert " m in a minute" in walk


def test_a_reference_that_does_not_fit_names_the_force(config):
    problem = build_problem(config, robot_of(config))
    n, m = problem.model.n, problem.nodes
    b = np.zeros((m, n))
    b[:, JOINT] = 5.0
    use = np.r_[np.ones(n, bool), np.zeros(6, bool)]
    rows = Rows(A=np.zeros((m * n, 1)), b=b.ravel(), root=np.eye(m * n), use=use)
    text = _remedy(problem, [rows])
    assert "the force of" in text
    assert "force_model_sigma_n: 5" in text
    assert not any(word in text for word in KEYS_OF_ANGLES)


def test_the_noise_of_a_force_is_in_newtons(config):
    problem = build_problem(config, robot_of(config))
    noise = SensorNoise(
        problem.noise_declared, problem.noise_samples, problem.window_s, problem.nodes
    )
    found = noise.report(problem.model.torque_units, problem.model.n)["torque_noise"]
    assert {"declared_n", "sigma_n"} <= found[JOINT].keys()
    assert {"declared_nm", "sigma_nm"} <= found[0].keys()


def test_an_implausible_zero_of_a_rail_is_in_metres(config):
    joints = [joint.model_copy(update={"zero_sigma_rad": 1e-3}) for joint in config.joints]
    problem = build_problem(config.model_copy(update={"joints": tuple(joints)}), robot_of(config))
    x = problem.prior_mean.copy()
    name = f"joint_zero.{config.joints[JOINT].name}"
    x[problem.names.index(name)] += 1.0
    text = problem.suspicion(x)
    assert "(+1 m)" in text
    assert "joints[].zero_sigma_m" in text
