"""Criteria: what they mean, and their derivatives."""

import numpy as np
import pytest

from planner import criteria
from planner.criteria import Gamma, Scale

P, STATES = 6, 9
GAMMA = Gamma(xi1=0.5, xi2=20.0)


def problem(seed=0):
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((40, STATES)) * np.logspace(0, 2, STATES)
    T = np.eye(P) + 0.1 * rng.standard_normal((P, P))
    scale = Scale(T=T, prior_sigma=np.logspace(0, 1, P), weights=rng.uniform(0.5, 2.0, P))
    return rows, scale, rng


@pytest.mark.parametrize("name", ["sigma", "d", "a", "e"])
def test_the_derivative_by_the_information(name):
    rows, scale, rng = problem()
    F, change = rows.T @ rows, rng.standard_normal((STATES, STATES))
    change, h = (change + change.T) * np.sqrt(np.outer(np.diag(F), np.diag(F))), 1e-6

    def value(F):
        return criteria.fused(name, np.linalg.cholesky(F).T, scale).value

    exact = criteria.fused(name, np.linalg.cholesky(F).T, scale).by_F
    numeric = (value(F + h * change) - value(F - h * change)) / (2 * h)
    assert np.sum(exact * change) == pytest.approx(numeric, rel=1e-6)


@pytest.mark.parametrize("name", ["cond", "gamma"])
def test_the_derivative_by_the_regressor_and_the_effort(name):
    rows, _, rng = problem()
    M, h = rows.T @ rows, 1e-6
    change = rng.standard_normal((STATES, STATES))
    change = (change + change.T) * np.sqrt(np.outer(np.diag(M), np.diag(M)))

    def value(M, effort):
        return criteria.regressor(name, np.linalg.cholesky(M).T, effort, GAMMA).value

    found = criteria.regressor(name, np.linalg.cholesky(M).T, 7.0, GAMMA)
    numeric = (value(M + h * change, 7.0) - value(M - h * change, 7.0)) / (2 * h)
    assert np.sum(found.by_M * change) == pytest.approx(numeric, rel=1e-5)
    numeric = (value(M, 7.0 + h) - value(M, 7.0 - h)) / (2 * h)
    assert found.by_effort == pytest.approx(numeric, rel=1e-6)


def test_sigma_is_the_weighted_geometric_mean():
    rows, scale, _ = problem()
    R = criteria.triangular_root(rows)
    C = scale.T @ np.linalg.solve(rows.T @ rows, np.eye(STATES))[:P, :P] @ scale.T.T
    expected = np.average(np.log(np.sqrt(np.diag(C))), weights=scale.weights)
    assert criteria.fused("sigma", R, scale).value == pytest.approx(expected, rel=1e-10)


def test_smooth_extremes_bound_the_exact_ones_within_a_few_percent():
    rows, scale, _ = problem()
    R = criteria.triangular_root(rows)
    exact = criteria.largest_sigma(R, scale)
    # a power mean of k values overestimates by at most k^(1/8), its root by half of that
    assert exact <= np.exp(criteria.fused("e", R, scale).value) <= exact * P ** (1 / 16)
    cond = criteria.exact_condition(R)
    found = np.exp(criteria.regressor("cond", R, 1.0, GAMMA).value)
    assert cond <= found <= cond * STATES ** (1 / 8)


def test_an_unweighted_quantity_does_not_count():
    rows, scale, _ = problem()
    R = criteria.triangular_root(rows)
    one = Scale(T=scale.T, prior_sigma=scale.prior_sigma, weights=np.eye(P)[2])
    C = criteria.report_covariance(R, one)
    for name in ("sigma", "d", "a", "e"):
        unit = 1.0 if name == "sigma" else scale.prior_sigma[2]
        found = np.exp(criteria.fused(name, R, one).value)
        assert found == pytest.approx(np.sqrt(C[2, 2]) / unit, rel=1e-8)


def test_an_unknown_name_is_a_mistake():
    rows, scale, _ = problem()
    with pytest.raises(ValueError, match="not a fused"):
        criteria.fused("best", criteria.triangular_root(rows), scale)
