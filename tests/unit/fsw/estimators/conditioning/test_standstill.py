"""Friction at rest is one error for a whole standstill: windows of it do not average it away."""

from dataclasses import replace

import numpy as np

from fsw.config import Config
from fsw.estimators.conditioning.blocks import Conditioner
from fsw.estimators.conditioning.standstill import LASTING, Standstills
from fsw.messages import Block, Window
from tests.support.estimator_cases import N, make_config, motion, sampled_window

COULOMB_NM = 2.0
REST = np.ones(2, np.bool_)


def test_only_the_first_window_of_a_standstill_counts() -> None:
    found = Standstills(np.full(2, 1e-6))
    at = np.array([0.3, -1.0])
    np.testing.assert_array_equal(found.factor(at, REST), [1.0, 1.0])
    np.testing.assert_array_equal(found.factor(at + 2e-5, REST), [LASTING, LASTING])
    moved = np.array([0.3, -0.9])  # the second joint has gone to another pose
    np.testing.assert_array_equal(found.factor(moved, REST), [LASTING, 1.0])
    np.testing.assert_array_equal(found.factor(moved, np.array([False, True])), [1.0, LASTING])
    np.testing.assert_array_equal(found.factor(moved, REST), [1.0, LASTING])  # it has moved since


def resting_windows(count: int) -> list[Window]:
    """Return windows before the motion begins, with noise."""
    history, rng = motion("target"), np.random.default_rng(0)
    return [sampled_window(history, rng, -2.4 + 0.4 * k) for k in range(count)]


def conditioned(config: Config, count: int) -> list[Block]:
    own = Conditioner(config, tuple(range(N)))
    blocks = [own.condition(window) for window in resting_windows(count)]
    return [block for block in blocks if block is not None]


def test_the_information_of_a_standstill_is_that_of_one_reading() -> None:
    config = make_config()
    joints = [
        joint.model_copy(update={"friction_coulomb_sigma_nm": COULOMB_NM})
        for joint in config.joints
    ]
    blocks = conditioned(config.model_copy(update={"joints": joints}), 5)
    assert len(blocks) == 5
    one = np.ones(len(blocks[0].q_rad))
    for k in range(N):
        known = sum(float(one @ np.linalg.solve(block.cov_tau[k], one)) for block in blocks)
        assert 0.95 < known * COULOMB_NM**2 < 1.05  # 5 of independent errors


def test_a_window_that_repeats_one_reading_counts_as_one() -> None:
    windows = resting_windows(1)
    held = []
    for channel in windows[0].joints:
        values = channel.values.copy()
        values[:, 1] = values[0, 1]
        held.append(replace(channel, values=values))
    own = Conditioner(make_config(), tuple(range(N)))
    free = own.condition(windows[0])
    block = own.condition(replace(windows[0], joints=tuple(held)))
    assert free is not None
    assert block is not None
    samples = len(windows[0].joints[0].t_ns)
    np.testing.assert_allclose(block.cov_tau, samples * free.cov_tau, rtol=1e-9)
