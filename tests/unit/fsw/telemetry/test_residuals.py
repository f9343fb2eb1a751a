"""Residual torques in telemetry: what the estimator in force leaves, over the declared noise."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.recursive.online import build_online
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.state.residuals import TorqueResidual, TorqueResiduals
from fsw.telemetry.state.values import estimate_values
from tests.support.estimator_cases import TORQUE_NOISE_NM, N, make_config, noisy_blocks, robot_model


@pytest.fixture(scope="module")
def flown():
    """A run of 40 s: its blocks and its last estimate."""
    config = make_config()
    blocks = noisy_blocks("target", 3)[:100]
    online = build_online(config, robot_model())
    for block in blocks:
        estimate = online.push(block)
    return TorqueResiduals(config), blocks, estimate


def test_a_good_estimate_leaves_the_declared_noise(flown):
    residuals, blocks, estimate = flown
    found = [residuals.of(block, estimate) for block in blocks[60:]]
    rms = np.array([[item.rms_nm for item in joints] for joints in found])
    ratio = np.array([[item.ratio for item in joints] for joints in found])
    assert rms.shape == (40, N)
    assert np.max(np.sqrt(np.mean(rms**2, axis=0))) < 2.0 * TORQUE_NOISE_NM, "not newton metres"
    assert np.sqrt(np.mean(ratio**2, axis=0)) == pytest.approx(np.ones(N), abs=0.25)


def test_a_wrong_estimate_shows(flown):
    residuals, blocks, estimate = flown
    wrong = estimate.mean.copy()
    wrong[0] *= 1.3
    ratios = [item.ratio for item in residuals.of(blocks[80], replace(estimate, mean=wrong))]
    assert max(ratios) > 3.0


def test_without_gyro_and_accelerometer_there_are_residuals_too(flown):
    residuals, blocks, estimate = flown
    blind = replace(blocks[80], has_gyro=False, has_accelerometer=False)
    assert max(item.ratio for item in residuals.of(blind, estimate)) < 3.0


def test_a_joint_without_torque_has_none_and_the_others_keep_their_places(flown):
    residuals, blocks, estimate = flown
    whole = residuals.of(blocks[80], estimate)
    has = np.ones(N, dtype=bool)
    has[2] = False
    part = residuals.of(replace(blocks[80], has_joint=has), estimate)
    assert part[2] == TorqueResidual()
    assert [p.rms_nm for p in part[:2]] == pytest.approx([w.rms_nm for w in whole[:2]], rel=0.2)
    assert residuals.of(replace(blocks[80], has_joint=~np.ones(N, dtype=bool)), estimate) == []


def test_an_estimate_of_other_states_has_none(flown):
    residuals, blocks, estimate = flown
    assert residuals.of(blocks[80], replace(estimate, names=("other",))) == []


def test_they_reach_their_fields(flown):
    residuals, blocks, estimate = flown
    found = residuals.of(blocks[80], estimate)
    values = estimate_values(estimate, estimate.t_ns, found, [f"joint{k}" for k in range(N)])
    assert values["residual_torque_3_ratio"] == found[2].ratio
    assert values["residual_torque_8"] == 0.0
    packet = next(p for p in DICTIONARY.packets if p.name == "estimate")
    assert {field.name for field in packet.fields} - {"sid"} <= set(values)
