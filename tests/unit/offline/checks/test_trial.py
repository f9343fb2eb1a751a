"""Samples of a recording, changed and cut into windows again, and mistakes found by them."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.conditioning.blocks import build_conditioner
from offline.checks.explanation import explain_residuals, unexplained
from offline.checks.recorded import sample_findings
from offline.checks.trial import ACCELEROMETER, GYRO, Stream, Trial, joined, make_trial, unwrapped
from tests.support.estimator_cases import make_config, motion, robot_model, windows


def stream(angles: np.ndarray, rate_hz: float = 100.0) -> Stream:
    t_ns = np.rint(np.arange(len(angles)) / rate_hz * 1e9).astype(np.int64)
    return Stream(t_ns, np.column_stack([angles, np.zeros(len(angles))]))


@pytest.fixture(scope="module")
def made() -> tuple[Trial, list, list]:
    config = make_config()
    own = list(windows(motion("target"), 3, 5.0, 15.0))
    blocks = [b for b in build_conditioner(config, robot_model()).blocks(own) if b is not None]
    return make_trial(config, robot_model(), own, blocks), own, blocks


def test_a_trial_without_a_change_has_the_blocks_of_the_recording(made):
    trial, _, blocks = made
    starts = {block.t_ns[0]: block for block in blocks}
    assert len(trial.blocks) == 8
    for block in trial.blocks:
        recorded = starts[block.t_ns[0]]
        for name in ("q_rad", "qdd_rad_s2", "tau_nm", "w_NB_B_rad_s", "f_NS_B_m_s2"):
            assert np.array_equal(getattr(block, name), getattr(recorded, name)), name


def test_a_correct_configuration_is_explained_by_nothing(made):
    trial, _, blocks = made
    verdict = explain_residuals(trial, blocks, lambda _: None)
    assert verdict.found == verdict.nearest == ()
    assert not verdict.mounting
    assert verdict.before < 1.5


def test_readings_of_a_joint_of_other_sign_and_zero_are_read_as_its_node_sends_them(made):
    trial = made[0]
    joint = trial.config.joints[1]
    joints = list(trial.config.joints)
    joints[1] = joint.model_copy(update={"sign": -1, "zero_offset_rad": 0.3})
    trial = trial.configured(joints=tuple(joints))
    q = trial.streams["joints.1"].values[:, 0]
    turned = np.where(np.arange(len(joints)) == 1, -1.0, 1.0)
    assert trial.reread(position=turned).streams["joints.1"].values[:, 0] == pytest.approx(
        -(q + 0.3) - 0.3
    )


@pytest.mark.parametrize("late_s", [0.012, -0.03])
def test_the_offset_of_a_clock_is_found_with_its_size(made, late_s):
    trial = made[0].shifted([GYRO, ACCELEROMETER], late_s)
    found = unexplained(trial)
    words = found.words
    if found.level > 3.0:
        words = list(explain_residuals(trial, made[2], lambda _: None).found)
    (line,) = words
    assert "imu: its clock differs" in line
    assert float(line.split("imu=")[1].split(")")[0]) == pytest.approx(-late_s, abs=2e-3)


def test_a_sign_of_all_torques_is_named_at_once_and_is_no_sensor(made):
    found = unexplained(made[0].reread(torque=-1.0))
    assert found.level > 3.0
    assert not found.one_sensor
    assert "all torques count the other way" in found.words[0]


def test_one_torque_that_is_wrong_is_told_from_the_rest(made):
    turned = np.ones(len(made[0].config.joints))
    turned[2] = 1.5
    found = unexplained(made[0].reread(torque=turned))
    assert found.level > 3.0
    assert found.one_sensor
    assert not found.words


def test_an_angle_that_wraps_is_unwrapped_and_nothing_else(made):
    joint = made[0].config.joints[0].model_copy(update={"speed_limit_rad_s": 3.0})
    t = np.arange(2000) / 100.0
    angle = 2.5 * t
    wrapped = stream((angle + np.pi) % (2.0 * np.pi) - np.pi)
    turns = wrapped.turns(joint)
    assert wrapped.values[:, 0] - 2.0 * np.pi * turns == pytest.approx(angle)
    assert np.count_nonzero(np.diff(turns)) == 8  # 50 rad, from 0 on: passes of pi, 3 pi ... 15 pi
    spike = angle * 0.01
    spike[700] += 2.0 * np.pi
    assert not stream(spike).turns(joint).any()
    in_degrees = stream(np.rad2deg(np.sin(t)))
    assert not in_degrees.turns(joint).any()
    moved, rows = stream(6.2 * (t > 8.0)), np.r_[0:700, 880:2000]
    assert not Stream(moved.t_ns[rows], moved.values[rows]).turns(joint).any(), "over a gap"


def test_windows_are_unwrapped_from_one_to_the_next(made):
    trial, own, _ = made
    q = joined([window.joints[0] for window in own]).values[:, 0]
    middle = np.median(q)
    changed = []
    for window in own:
        channel = window.joints[0]
        values = channel.values.copy()
        values[:, 0] -= 2.0 * np.pi * (values[:, 0] > middle)
        joints = (replace(channel, values=values), *window.joints[1:])
        changed.append(replace(window, joints=joints))
    even = joined([w.joints[0] for w in unwrapped(trial.config, changed)]).values[:, 0]
    assert np.ptp(even - q) < 1e-9
    (line,) = sample_findings(trial.config, changed)
    assert "joints.0 (joint1): its angle wraps" in line
    assert sample_findings(trial.config, own) == []
