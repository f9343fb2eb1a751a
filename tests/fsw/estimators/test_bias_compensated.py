"""Bias-compensated MRNEA: what noise adds is what is taken off, in memory that does not grow."""

from __future__ import annotations

import numpy as np

from fsw.estimators.bias_compensated import BiasCompensatedEstimator, block_sums
from fsw.estimators.online import build_online
from tests.fsw.estimators.cases import (
    TARGET,
    make_config,
    make_problem,
    noisy,
    noisy_blocks,
    parameters,
    robot_model,
    true_blocks_cached,
)

NO_BIAS = {"torque": np.zeros(7), "gyro": np.zeros(3), "acc": np.zeros(3)}


def test_the_compensation_is_what_noise_adds_to_the_normal_matrix() -> None:
    """Mean of 300 noisy normal matrices less the clean one, to 5 standard errors and 15 %.

    The 15 % are the noise of the rates, which the compensation leaves out.
    """
    problem = make_problem(("target",), biases=False)
    x, block = parameters(TARGET), true_blocks_cached("target", 59.9)[60]
    clean = block_sums(block, x, problem)
    rng = np.random.default_rng(0)
    draws = np.array([np.diag(block_sums(noisy(block, rng, NO_BIAS), x, problem).F)[:10]
                      for _ in range(300)])  # fmt: skip
    added = draws.mean(axis=0) - np.diag(clean.F)[:10]
    error = draws.std(axis=0) / np.sqrt(len(draws))
    expected = np.diag(clean.C)[:10]
    assert np.all(np.abs(added - expected) < 5 * error + 0.15 * expected)


def test_the_mass_is_nearer_than_by_the_papers_regression_and_marked_biased() -> None:
    """Over three seeds: OLS ends 10 % low; the compensated one within 2 %."""
    errors = {"ols": [], "bc": []}
    for weighting, found in errors.items():
        for seed in range(3):
            config = make_config(("target",), method="mrnea", weighting=weighting)
            online = build_online(config, robot_model())
            for block in noisy_blocks("target", seed):
                estimate = online.push(block)
            assert estimate.extra["biased"] == 1.0
            found.append(abs(estimate.mean[0] / TARGET.mass_kg - 1.0))
    assert min(errors["ols"]) > 0.05
    assert max(errors["bc"]) < 0.02


def test_nothing_grows_and_repeats_are_ignored() -> None:
    config = make_config(("target",), method="mrnea", weighting="bc")
    online = build_online(config, robot_model())
    assert isinstance(online, BiasCompensatedEstimator)
    for block in noisy_blocks("target", 1, 8.0):
        first = online.push(block)
        again = online.push(block)
        assert np.array_equal(first.mean, again.mean)
        assert not online.work()
    assert again.extra["ignored"] == again.blocks
    assert online.report()["names"] == list(again.names)
