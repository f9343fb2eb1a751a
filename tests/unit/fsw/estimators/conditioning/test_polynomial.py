"""Values at Gauss-Legendre nodes: uncorrelated, exact, superconvergent."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from fsw.estimators.conditioning.polynomial import NodeFit, gauss_nodes

HALF_S = 0.2


def uniform(count: int) -> np.ndarray:
    return (np.arange(count) + 0.5) / count * 2 * HALF_S - HALF_S


@pytest.mark.parametrize("nodes", [2, 3, 4, 6])
def test_values_at_the_nodes_are_uncorrelated(nodes: int) -> None:
    """Bound: uniform samples approximate the integral to order (nodes / samples)^2."""
    C = NodeFit(uniform(200), HALF_S, nodes - 1, nodes).covariance((0,), 1.0)
    scale = np.sqrt(np.diag(C))
    correlation = C / np.outer(scale, scale) - np.eye(nodes)
    assert np.abs(correlation).max() < 0.02


@pytest.mark.parametrize(("degree", "nodes"), [(3, 4), (6, 4), (2, 3), (5, 5)])
def test_polynomials_of_the_degree_are_reproduced_with_derivatives(degree: int, nodes: int) -> None:
    rng = np.random.default_rng(degree)
    p = Polynomial(rng.normal(size=degree + 1))
    t = np.sort(rng.uniform(-HALF_S, HALF_S, 80))
    fit = NodeFit(t, HALF_S, degree, nodes)
    c = fit.coefficients(p(t))
    at = gauss_nodes(nodes) * HALF_S
    for order in range(3):
        expected = p.deriv(order)(at) if order else p(at)
        np.testing.assert_allclose(fit.operator(order) @ c, expected, atol=1e-9)
    np.testing.assert_allclose(fit.residuals(p(t), c), 0.0, atol=1e-13)


@pytest.mark.parametrize("nodes", [3, 4, 5])
def test_the_next_power_leaves_no_error_at_the_nodes(nodes: int) -> None:
    """Degree m-1 fitted to t^m: its error is a multiple of P_m, zero at the nodes."""
    t = uniform(400)
    power = (t / HALF_S) ** nodes
    fit = NodeFit(t, HALF_S, nodes - 1, nodes)
    c = fit.coefficients(power)
    at_nodes = np.abs(fit.operator(0) @ c - gauss_nodes(nodes) ** nodes).max()
    anywhere = np.abs(fit.residuals(power, c)).max()
    assert at_nodes < 1e-3 * anywhere


def test_covariance_is_that_of_the_estimator_on_white_noise() -> None:
    rng = np.random.default_rng(3)
    fit = NodeFit(uniform(60), HALF_S, 5, 3)
    E = np.concatenate([fit.operator(1), fit.operator(2)])
    draws = 20_000
    values = E @ fit.coefficients(0.3 * rng.normal(size=(60, draws)))
    C = fit.covariance((1, 2), 0.3)
    scale = np.sqrt(np.diag(C))
    sample = values @ values.T / draws
    # entries of a sample covariance deviate by at most sqrt(2 / draws) = 0.01
    unit = np.outer(scale, scale)
    np.testing.assert_allclose(sample / unit, C / unit, atol=0.05)


def test_sampling_need_not_be_uniform_nor_the_values_scalar() -> None:
    t = np.sort(np.random.default_rng(1).uniform(-HALF_S, HALF_S, 30))
    fit = NodeFit(t, HALF_S, 3, 4)
    c = fit.coefficients(np.stack([t, 2 * t**3, np.ones_like(t)], axis=1))
    at = gauss_nodes(4) * HALF_S
    expected = np.stack([at, 2 * at**3, np.ones_like(at)], axis=1)
    np.testing.assert_allclose(fit.operator(0) @ c, expected, atol=1e-12)
