"""Bias-compensated MRNEA: what noise adds is what is taken off, in memory that does not grow."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.measurement.compensated import block_sums
from fsw.estimators.model.building import build_problem
from fsw.estimators.recursive.bias_compensated import BiasCompensatedEstimator
from fsw.estimators.recursive.online import build_online
from tests.support.estimator_cases import (
    TARGET,
    make_config,
    make_problem,
    noisy,
    noisy_blocks,
    parameters,
    robot_model,
    true_block,
    true_blocks_cached,
)
from tests.unit.fsw.estimators.test_external_moments import FORCE_N, MOMENT_NM, disturbed

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


@pytest.mark.parametrize("kind", ["scale", "gyro", "wrench"])
def test_every_nuisance_explains_what_it_does(kind) -> None:
    """Exact rows with one error put in: its state takes at least 99.9 % of the squares away."""
    config = make_config(("target",), external_force_sigma_n=0.1, external_torque_sigma_nm=0.1)
    scaled = [
        joint.model_copy(update={"torque_scale_sigma_ratio": 0.01}) for joint in config.joints
    ]
    problem = build_problem(config.model_copy(update={"joints": scaled}), robot_model())
    truth = problem.prior_mean.copy()
    truth[:10] = parameters(TARGET)
    with_it = truth.copy()
    if kind == "wrench":
        block = true_block(disturbed("wrench"), 30.0)
        with_it[problem.at("wrench")] = np.concatenate([FORCE_N, MOMENT_NM])
    else:
        block = true_blocks_cached("target", 59.9)[60]
    if kind == "scale":
        error = np.array([0.01, -0.02, 0.01, 0.03, -0.01, 0.02, 0.01])
        block = replace(block, tau_nm=block.tau_nm * (1 + error))
        with_it[problem.at("torque_scale")] = error / (1 + error)
    if kind == "gyro":
        with_it[problem.at("gyro_bias")] = [3e-5, -2e-5, 1e-5]
        block = replace(block, w_NB_B_rad_s=block.w_NB_B_rad_s + with_it[problem.at("gyro_bias")])
    F = block_sums(block, truth, problem).F
    squares = [float(np.append(x, -1.0) @ F @ np.append(x, -1.0)) for x in (truth, with_it)]
    assert squares[1] < 1e-3 * squares[0]


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
