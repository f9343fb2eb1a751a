"""The recursive estimator: equal to the batch, consistent, bounded, and honest about validity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.config import Config
from fsw.estimators.measurement.fused import fused_rows
from fsw.estimators.measurement.mrnea import Rows, mrnea_rows
from fsw.estimators.measurement.row_functions import row_function
from fsw.estimators.model.inertia import is_consistent, nearest_consistent
from fsw.estimators.model.problem import Problem, build_problem
from fsw.estimators.recursive.online import WORK_PER_BLOCK, OnlineEstimator, build_online
from fsw.estimators.recursive.recursion import FLAT_PRIOR
from fsw.messages import Block, Estimate
from tests.support.estimator_cases import (
    NODES,
    TARGET,
    at_rest,
    draw_biases,
    noisy,
    noisy_blocks,
    robot_model,
    true_block,
    true_blocks_cached,
)
from tests.support.estimator_cases import motion as true_motion
from tests.support.starts import CASES, config_of, truth_of

POINT_UNITS = 41  # most units of one piece of work: finding a consistent point to begin a pass at
BATCH_BOUNDS = {"base": 0.05, "target": 0.05, "both": 0.2}  # whitened rms


def run(config: Config, blocks: list[Block]) -> tuple[OnlineEstimator, list[Estimate]]:
    online = build_online(config, robot_model())
    return online, [online.push(block) for block in blocks]


def whitened_rms(a: np.ndarray, b: np.ndarray, covariance: np.ndarray) -> float:
    step = a - b
    return float(np.sqrt(step @ np.linalg.solve(covariance, step) / len(step)))


def batch(
    problem: Problem, blocks: list[Block], rows_of: Callable[[Block, np.ndarray], Rows]
) -> tuple[np.ndarray, np.ndarray]:
    """Return mode and covariance by plain Gauss-Newton on the normal equations, to convergence."""
    p = len(problem.prior_mean)
    inverse = np.linalg.solve(problem.prior_covariance, np.eye(p))
    x, covariance = problem.prior_mean.copy(), problem.prior_covariance
    for _ in range(40):
        at = x.copy()
        for name in problem.unknown:
            k = problem.body(name)
            if not is_consistent(at[k]):
                at[k] = nearest_consistent(at[k], covariance[k, k])
        F, g = inverse, inverse @ (problem.prior_mean - at)
        for block in blocks:
            rows = rows_of(block, at)
            F, g = F + rows.A.T @ rows.A, g + rows.A.T @ rows.b
        covariance = np.linalg.solve(F, np.eye(p))
        new = at + covariance @ g
        moved = whitened_rms(new, x, covariance)
        x = new
        if moved < 1e-4:
            return x, covariance
    raise AssertionError("the batch did not converge")


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


@pytest.mark.parametrize("method", ["fused", "mrnea"])
@pytest.mark.parametrize("case", list(CASES))
def test_recursion_from_a_wrong_start_ends_at_the_batch(case: str, method: str) -> None:
    """Without finish(), after 60 s; then finish() meets an independent batch to 0.01."""
    config = config_of(case, 2, method=method)
    blocks = noisy_blocks(CASES[case][0], 2)
    online, estimates = run(config, blocks)
    problem = build_problem(config, robot_model())

    def rows_of(block: Block, x: np.ndarray) -> Rows:
        if method == "fused":
            return fused_rows(block, x, problem)
        return mrnea_rows(block, x, problem, "eiv")

    mode, covariance = batch(problem, blocks, rows_of)
    last, final = estimates[-1], online.finish()
    assert last.gated == 0
    assert whitened_rms(last.mean, final.mean, final.covariance) < BATCH_BOUNDS[case]
    assert whitened_rms(last.mean, mode, covariance) < BATCH_BOUNDS[case]
    assert whitened_rms(final.mean, mode, covariance) < 0.01
    assert final.valid
    error = final.mean[problem.bodies] - truth_of(case)
    k = problem.bodies
    nees = error @ np.linalg.solve(final.covariance[k, k], error)
    assert nees < chi2.ppf(0.9999, len(error))


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


@lru_cache(maxsize=1)
def seeds() -> tuple[tuple[np.ndarray, Estimate], ...]:
    """Return (true nuisances, final estimate) of 24 runs of 20 s of the target's motion."""
    results = []
    for seed in range(24):
        config = config_of("target", 50 + seed)
        rng = np.random.default_rng(seed)
        biases = draw_biases(rng)
        biases["torque"] *= 2.0  # 0.2 N m, the prior's sigma
        blocks = [noisy(b, rng, biases) for b in true_blocks_cached("target", 59.9)[50:90]]
        online, _ = run(config, blocks)
        nuisance = np.concatenate([biases["torque"], biases["acc"], biases["gyro"]])
        results.append((nuisance, online.finish()))
    return tuple(results)


def test_errors_over_seeds_are_those_of_the_covariance() -> None:
    """NEES of bodies, and of the whole state, summed over 24 seeds: 99 % band of chi-square."""
    truth = truth_of("target")
    bodies = whole = 0.0
    for nuisance, estimate in seeds():
        error = estimate.mean - np.concatenate([truth, nuisance])
        P = estimate.covariance
        bodies += error[:10] @ np.linalg.solve(P[:10, :10], error[:10])
        whole += error @ np.linalg.solve(P, error)
    for total, dof in ((bodies, 24 * 10), (whole, 24 * 23)):
        low, high = chi2.ppf([0.005, 0.995], dof)
        assert low < total < high, total / dof


def test_published_sigmas_cover_the_published_bodies() -> None:
    """Mass, centre and inertia of the 24 runs, each over its sigma: 99.99 % bounds."""
    z = np.array(
        [
            [
                (e.bodies["target"].mass_kg - TARGET.mass_kg) / e.bodies["target"].mass_sigma_kg,
                *(e.bodies["target"].com_m - TARGET.com_m) / e.bodies["target"].com_sigma_m,
                *(e.bodies["target"].inertia_kg_m2 - TARGET.inertia_kg_m2)
                / e.bodies["target"].inertia_sigma_kg_m2,
            ]
            for _, e in seeds()
        ]
    )
    low, high = chi2.ppf([5e-5 / 10, 1 - 5e-5 / 10], len(z))
    total = np.sum(z**2, axis=0)
    assert np.all((low < total) & (total < high))


@pytest.mark.parametrize("case", ["base", "target", "both"])
def test_validity_comes_and_stays_while_data_keep_coming(case: str) -> None:
    """New data move the estimate; only re-linearisation that moves it means not converged."""
    _, estimates = run(config_of(case, 2), noisy_blocks(CASES[case][0], 2))
    late = estimates[len(estimates) // 2 :]
    assert sum(e.valid for e in late) > 0.8 * len(late)


STORE = 40
STORE_BOUND = 0.3  # whitened rms


@pytest.mark.parametrize("case", ["target", "both"])
def test_a_small_store_is_bounded_and_nearly_as_good(case: str) -> None:
    blocks = noisy_blocks(CASES[case][0], 2)
    small = build_online(config_of(case, 2, store_blocks=STORE), robot_model())
    for block in blocks:
        small.push(block)
        assert len(small.recursion.memory) <= STORE
    full, _ = run(config_of(case, 2), blocks)
    reference, estimate = full.finish(), small.finish()
    assert estimate.blocks == reference.blocks == len(blocks)
    assert whitened_rms(estimate.mean, reference.mean, reference.covariance) < STORE_BOUND
    ratio = np.diag(estimate.covariance) / np.diag(reference.covariance)
    assert np.all((ratio > 0.5) & (ratio < 2.0))  # nothing lost, nothing counted twice


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
