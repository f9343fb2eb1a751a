"""The recursion over whole motions: equal to the batch, consistent, bounded, and valid in time."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.inertia import (
    from_parameters,
    is_consistent,
    nearest_consistent,
    report_jacobian,
)
from fsw.estimators.model.problem import Problem
from fsw.estimators.recursive.online import build_online
from fsw.messages import Block, Estimate
from tests.support.estimator_cases import (
    TARGET,
    draw_biases,
    noisy,
    noisy_blocks,
    robot_model,
    true_blocks_cached,
)
from tests.support.one_block import fused_rows, mrnea_rows
from tests.support.starts import CASES, config_of, truth_of

BATCH_BOUNDS = {"base": 0.05, "target": 0.05, "both": 0.2}  # whitened rms


@lru_cache(maxsize=6)
def whole_run(case: str, method: str) -> tuple[list[Estimate], Estimate]:
    """Return the estimate after every block of 60 s from a wrong start, and the settled one."""
    online = build_online(config_of(case, 2, method=method), robot_model())
    estimates = [online.push(block) for block in noisy_blocks(CASES[case][0], 2)]
    return estimates, online.finish()


def whitened_rms(a: np.ndarray, b: np.ndarray, covariance: np.ndarray) -> float:
    step = a - b
    return float(np.sqrt(step @ np.linalg.solve(covariance, step) / len(step)))


def stated(pi: np.ndarray) -> np.ndarray:
    return np.hstack(from_parameters(pi))


def batch(
    problem: Problem,
    blocks: list[Block],
    rows_of: Callable[[Block, np.ndarray, Impulse | None], Rows],
) -> tuple[np.ndarray, np.ndarray]:
    """Return mode and covariance by plain Gauss-Newton on the normal equations, to convergence."""
    mean, p = problem.prior_mean, len(problem.prior_mean)
    inverse = np.linalg.solve(problem.prior_covariance, np.eye(p))
    x, covariance = problem.prior_mean.copy(), problem.prior_covariance
    for _ in range(40):
        at = x.copy()
        for name in problem.unknown:
            k = problem.body(name)
            if not is_consistent(at[k]):
                at[k] = nearest_consistent(at[k], covariance[k, k])
        off, D = at - mean, np.eye(p)  # of what is stated: mass, centre of mass, inertia
        for k in map(problem.body, problem.unknown):
            J = report_jacobian(mean[k])
            off[k] = np.linalg.solve(J, stated(at[k]) - stated(mean[k]))
            D[k, k] = np.linalg.solve(J, report_jacobian(at[k]))
        F, g = D.T @ inverse @ D, -D.T @ inverse @ off
        before = None
        for block in blocks:
            rows = rows_of(block, at, before)
            before = rows.after
            F, g = F + rows.A.T @ rows.A, g + rows.A.T @ rows.b
        covariance = np.linalg.solve(F, np.eye(p))
        new = at + covariance @ g
        moved = whitened_rms(new, x, covariance)
        x = new
        if moved < 1e-4:
            return x, covariance
    raise AssertionError("the batch did not converge")


@pytest.mark.parametrize("method", ["fused", "mrnea"])
@pytest.mark.parametrize("case", list(CASES))
def test_recursion_from_a_wrong_start_ends_at_the_batch(case: str, method: str) -> None:
    """Without finish(), after 60 s; then finish() meets an independent batch to 0.01."""
    config = config_of(case, 2, method=method)
    blocks = noisy_blocks(CASES[case][0], 2)
    estimates, final = whole_run(case, method)
    problem = build_problem(config, robot_model())

    def rows_of(block: Block, x: np.ndarray, before: Impulse | None) -> Rows:
        if method == "fused":
            return fused_rows(block, x, problem, before=before)
        return mrnea_rows(block, x, problem, "eiv")

    mode, covariance = batch(problem, blocks, rows_of)
    last = estimates[-1]
    assert last.gated == 0
    assert whitened_rms(last.mean, final.mean, final.covariance) < BATCH_BOUNDS[case]
    assert whitened_rms(last.mean, mode, covariance) < BATCH_BOUNDS[case]
    assert whitened_rms(final.mean, mode, covariance) < 0.01
    assert final.valid
    error = final.mean[problem.bodies] - truth_of(case)
    k = problem.bodies
    nees = error @ np.linalg.solve(final.covariance[k, k], error)
    assert nees < chi2.ppf(0.9999, len(error))


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
        online = build_online(config, robot_model())
        for block in blocks:
            online.push(block)
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
    estimates, _ = whole_run(case, "fused")
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
    reference, estimate = whole_run(case, "fused")[1], small.finish()
    assert estimate.blocks == reference.blocks == len(blocks)
    assert whitened_rms(estimate.mean, reference.mean, reference.covariance) < STORE_BOUND
    ratio = np.diag(estimate.covariance) / np.diag(reference.covariance)
    assert np.all((ratio > 0.5) & (ratio < 2.0))  # nothing lost, nothing counted twice
