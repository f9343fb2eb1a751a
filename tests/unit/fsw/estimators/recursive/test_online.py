"""The recursive estimator: equal to the batch, consistent, bounded, and honest about validity."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.config import Config
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.measurement.row_functions import RowsFunction, row_function, usable_rows
from fsw.estimators.model.building import build_problem
from fsw.estimators.recursive import estimation
from fsw.estimators.recursive.online import WORK_PER_BLOCK, OnlineEstimator, build_online
from fsw.estimators.recursive.origin import FLAT_PRIOR
from fsw.estimators.recursive.pacing import WORTH
from fsw.messages import Block, Estimate
from tests.support.estimator_cases import (
    NODES,
    at_rest,
    draw_biases,
    noisy,
    noisy_blocks,
    robot_model,
    true_block,
)
from tests.support.estimator_cases import motion as true_motion
from tests.support.one_block import mrnea_rows
from tests.support.starts import config_of, truth_of

POINT_UNITS = 41  # most units of one piece of work: finding a consistent point to begin a pass at


def run(config: Config, blocks: list[Block]) -> tuple[OnlineEstimator, list[Estimate]]:
    online = build_online(config, robot_model())
    return online, [online.push(block) for block in blocks]


def whitened_rms(a: np.ndarray, b: np.ndarray, covariance: np.ndarray) -> float:
    step = a - b
    return float(np.sqrt(step @ np.linalg.solve(covariance, step) / len(step)))


@pytest.mark.parametrize("weighting", ["ols", "wls"])
def test_linear_weightings_are_stacked_least_squares(weighting: str) -> None:
    """Rows linearised at the prior and solved by lstsq: 1e-6 of every sigma."""
    blocks = noisy_blocks("target", 1, 30.0)
    config = config_of("target", 1, method="mrnea", weighting=weighting)
    _, estimates = run(config, blocks)
    got = estimates[-1]
    problem = build_problem(config, robot_model())
    x = problem.prior_mean
    L = np.linalg.cholesky(FLAT_PRIOR**2 * problem.prior_covariance)
    A, c = [np.linalg.solve(L, np.eye(len(x)))], [np.linalg.solve(L, x)]
    for block in blocks:
        rows = mrnea_rows(block, x, problem, weighting)
        A.append(rows.A)
        c.append(rows.b + rows.A @ x)
    stacked = np.vstack(A)
    scale = np.linalg.norm(stacked, axis=0)
    expected = np.linalg.lstsq(stacked / scale, np.concatenate(c), rcond=None)[0] / scale
    sigma = np.sqrt(np.diag(got.covariance))
    assert np.abs((got.mean - expected) / sigma).max() < 1e-6
    assert got.blocks == len(blocks)


@pytest.mark.parametrize("wider", [1e2, 1e5])
@pytest.mark.parametrize(
    ("method", "weighting"), [("mrnea", "ols"), ("rda", "eiv"), ("fused", "eiv")]
)
def test_a_prior_of_any_width_never_stops_the_recursion(
    method: str, weighting: str, wider: float
) -> None:
    """The unit of the whitened noise is lost beside the square of such a prior."""
    config = config_of("base", 1, method=method, weighting=weighting)
    problem = build_problem(config, robot_model())
    scale = np.ones(len(problem.prior_mean))
    scale[problem.bodies] = wider
    flat = replace(problem, prior_covariance=problem.prior_covariance * np.outer(scale, scale))
    rows = row_function(method, weighting, flat)
    online = OnlineEstimator(flat, config.estimator, rows, linear=weighting == "ols")
    for block in noisy_blocks("base", 1, 10.0):
        estimate = online.push(block)
        assert np.all(np.isfinite(estimate.mean))
        assert np.all(np.diag(estimate.covariance) > 0.0)


@pytest.mark.parametrize("method", ["fused", "mrnea"])
def test_results_do_not_depend_on_how_often_work_is_called(method: str) -> None:
    config = config_of("target", 3, method=method)
    blocks = noisy_blocks("target", 3, 12.0)
    _, never = run(config, blocks)
    online = build_online(config, robot_model())
    rng = np.random.default_rng(0)
    for block, expected in zip(blocks, never, strict=True):
        got = online.push(block)
        assert np.array_equal(got.mean, expected.mean)
        assert np.array_equal(got.covariance, expected.covariance)
        assert (got.reason, got.nis) == (expected.reason, expected.nis)
        for _ in range(rng.integers(0, 40)):
            online.work()


def test_work_is_bounded_between_blocks() -> None:
    online = build_online(config_of("target", 3), robot_model())
    for block in noisy_blocks("target", 3, 10.0):
        online.push(block)
        calls = 1
        while online.work():
            calls += 1
            assert calls <= WORK_PER_BLOCK * POINT_UNITS
        assert not online.work()


@pytest.mark.parametrize("method", ["fused", "mrnea"])
def test_passes_that_would_change_nothing_are_not_made(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bound: what a pass is worth making for, twice: of the last one and of the next."""
    config, blocks = config_of("target", 5, method=method), noisy_blocks("target", 5, 30.0)

    def watched() -> tuple[list[Estimate], list[int], int]:
        online, passes, calls = build_online(config, robot_model()), list[int](), 0

        def counted(rows: RowsFunction, blocks: Sequence[Block], *arguments: Any) -> list[Rows]:
            nonlocal calls
            calls += len(blocks)
            return usable_rows(rows, blocks, *arguments)

        monkeypatch.setattr(estimation, "usable_rows", counted)
        estimates = []
        for block in blocks:
            estimates.append(online.push(block))
            passes.append(online.recursion.memory.passes)
        return estimates, passes, calls

    some, few, rare = watched()
    monkeypatch.setattr(estimation, "SAMPLES", 10**6)
    every, many, often = watched()
    assert few[-1] < many[-1]
    assert rare < 0.75 * often
    for a, b in zip(some, every, strict=True):
        assert a.valid == b.valid
        assert whitened_rms(a.mean, b.mean, b.covariance) < 2 * WORTH


@pytest.mark.parametrize("name", ["tau_nm", "w_NB_B_rad_s", "f_NS_B_m_s2", "qdd_rad_s2"])
@pytest.mark.parametrize("method", ["fused", "mrnea"])
def test_a_block_that_is_not_finite_is_gated_and_changes_nothing(method: str, name: str) -> None:
    blocks = noisy_blocks("target", 1, 6.0)
    config = config_of("target", 1, method=method)
    values = getattr(blocks[-1], name).copy()
    values[1, 0] = np.nan
    clean, estimates = run(config, blocks[:-1])
    while clean.work():
        pass
    before = clean.estimate(0)
    after = clean.push(replace(blocks[-1], **{name: values}))
    assert after.gated == estimates[-1].gated + 1
    assert after.blocks == len(blocks) - 1
    assert np.array_equal(after.mean, before.mean)
    assert np.array_equal(after.covariance, before.covariance)


def test_a_block_that_contradicts_is_gated_once_settled() -> None:
    blocks = noisy_blocks("target", 1, 30.0)
    online, _ = run(config_of("target", 1), blocks[:-1])
    before = online.finish()
    assert before.valid
    bad = replace(blocks[-1], tau_nm=blocks[-1].tau_nm + 5.0)
    after = online.push(bad)
    assert after.gated == before.gated + 1
    assert np.array_equal(after.mean, before.mean)


@pytest.mark.parametrize(
    ("method", "weighting"),
    [
        ("fused", "eiv"),
        ("mrnea", "eiv"),
        ("mrnea", "ols"),
    ],
)
def test_an_arm_at_rest_says_nothing_and_is_not_valid(method: str, weighting: str) -> None:
    """40 windows of the rest before the motion; the target's mass must stay at its prior."""
    config = config_of("target", 1, method=method, weighting=weighting)
    rng = np.random.default_rng(0)
    biases = draw_biases(rng)
    still = true_block(true_motion("target"), -2.0)
    blocks = [at_rest(noisy(replace(still, index=k), rng, biases)) for k in range(40)]
    online, estimates = run(config, blocks)
    final = online.finish()
    assert not any(e.valid for e in [*estimates, final])
    if weighting == "eiv":
        prior = config.bodies["target"].sigma
        assert prior is not None
        assert final.bodies["target"].mass_sigma_kg > 0.5 * prior.mass_kg


def test_reset_forgets_everything() -> None:
    config = config_of("target", 1)
    blocks = noisy_blocks("target", 1, 8.0)
    online, first = run(config, blocks)
    online.reset()
    again = [online.push(block) for block in blocks]
    assert np.array_equal(again[-1].mean, first[-1].mean)
    assert again[-1].blocks == first[-1].blocks


def test_before_any_block_the_estimate_is_the_prior() -> None:
    config = config_of("both", 1)
    online = build_online(config, robot_model())
    estimate = online.finish()
    problem = build_problem(config, robot_model())
    assert not estimate.valid
    assert estimate.reason == "TOO_FEW_BLOCKS"
    np.testing.assert_allclose(estimate.mean, problem.prior_mean)
    np.testing.assert_allclose(estimate.covariance, problem.prior_covariance, rtol=1e-6, atol=1e-9)
    assert estimate.information_gained_nats == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("method", ["fused", "mrnea", "rda"])
def test_missing_channels_are_left_out_without_harm(method: str) -> None:
    blocks = noisy_blocks("target", 4, 20.0)
    some = [
        replace(
            b,
            has_gyro=b.index % 3 != 0,
            w_NB_B_rad_s=b.w_NB_B_rad_s if b.index % 3 else np.zeros((NODES, 3)),
            wd_NB_B_rad_s2=b.wd_NB_B_rad_s2 if b.index % 3 else np.zeros((NODES, 3)),
            cov_gyro=b.cov_gyro if b.index % 3 else np.eye(2 * NODES),
        )
        for b in blocks
    ]
    config = config_of("target", 4, method=method)
    online, _ = run(config, some)
    final = online.finish()
    assert final.gated == 0
    error = final.mean[:10] - truth_of("target")
    nees = error @ np.linalg.solve(final.covariance[:10, :10], error)
    assert nees < chi2.ppf(0.9999, 10)
