"""A prior stated of mass, centre of mass and inertia, where the state is moments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from fsw.estimators.batch.solver import minimise
from fsw.estimators.model.inertia import from_parameters, is_consistent, to_parameters
from fsw.estimators.model.prior import Prior
from fsw.messages import FloatArray
from tests.support.estimator_cases import make_problem

DRAWS = 300
FACTOR_SIGMA = 0.03
SIGMA = np.array([350.0, 0.15, 0.15, 0.15, *[60.0] * 6])  # of the base below
MEAN = (1000.0, np.array([0.2, -0.1, 0.3]), np.array([300.0, 10.0, -20.0, 350.0, 5.0, 400.0]))


def stated(pi: FloatArray) -> FloatArray:
    mass, com, inertia = from_parameters(pi)
    return np.concatenate(([mass], com, inertia))


def base_prior() -> Prior:
    mean = to_parameters(*MEAN)
    step = 1e-6 * SIGMA
    columns = [(moments(stated(mean) + d) - moments(stated(mean) - d)) / 2 for d in np.diag(step)]
    root = np.array(columns).T / 1e-6
    return Prior(mean, root @ root.T, (slice(0, 10),))


def moments(report: FloatArray) -> FloatArray:
    return to_parameters(float(report[0]), report[1:4], report[4:])


def drawn(rng: np.random.Generator) -> FloatArray:
    while True:
        pi = moments(stated(to_parameters(*MEAN)) + SIGMA * rng.standard_normal(10))
        if pi[0] > 0.4 * MEAN[0] and is_consistent(pi):
            return pi


def test_cost_is_the_distance_in_what_is_stated() -> None:
    prior, rng = base_prior(), np.random.default_rng(1)
    for _ in range(20):
        x = drawn(rng)
        off = (stated(x) - stated(prior.mean)) / SIGMA
        assert prior.cost(x) == pytest.approx(off @ off, rel=1e-6)


def test_information_is_the_gauss_newton_form_of_the_cost() -> None:
    """Gradient of the cost by finite differences; curvature along what is stated: one sigma."""
    prior, x = base_prior(), drawn(np.random.default_rng(2))
    known = prior.at(x)
    step = 1e-5 * np.sqrt(np.diag(prior.covariance))
    slope = [(prior.cost(x + d) - prior.cost(x - d)) / (2 * d.max()) for d in np.diag(step)]
    gradient = 2.0 * known.R.T @ (known.R @ x - known.z)
    scale = np.sqrt(np.diag(prior.covariance))
    np.testing.assert_allclose(gradient * scale, slope * scale, rtol=1e-4, atol=1e-4)
    ways = np.array(
        [moments(stated(x) + d) - moments(stated(x) - d) for d in 1e-6 * np.diag(SIGMA)]
    )
    R = known.R @ ways.T / 2e-6
    np.testing.assert_allclose(R.T @ R, np.eye(10), atol=1e-5)


def test_at_its_mean_and_of_a_light_body_it_is_the_gaussian_of_the_state() -> None:
    prior = base_prior()
    plain = Prior(prior.mean, prior.covariance, ())
    light = prior.mean.copy()
    light[:4] *= 0.2
    for x in (prior.mean, light):
        np.testing.assert_array_equal(prior.at(x).R, plain.at(x).R)
        np.testing.assert_array_equal(prior.at(x).z, plain.at(x).z)


def test_a_factor_that_only_the_prior_knows_is_as_uncertain_as_stated() -> None:
    """The base is seen but for a factor known to 3 %, as by thrusters: 1 sigma is what it errs by.

    Truths and factors are drawn from what is stated. A mode is 0.2 sigma below the mean here: ten
    parameters and three centres of mass scale with the factor, 7 x 3 %. Linearised at its mean the
    prior is nearly one sigma off on the mean.
    """
    prior, rng, errors = base_prior(), np.random.default_rng(3), []
    own = make_problem(("base",), biases=False)
    problem = replace(
        own,
        names=(*own.names, "factor"),
        prior_mean=np.append(prior.mean, 0.0),
        prior_covariance=block_diag(prior.covariance, FACTOR_SIGMA**2),
    )
    weight = np.linalg.inv(np.linalg.cholesky(prior.covariance)) * 1e3
    for _ in range(DRAWS):
        truth, factor = drawn(rng), FACTOR_SIGMA * rng.standard_normal()
        seen = weight @ truth / (1.0 + factor) + rng.standard_normal(10)

        def rows(x: FloatArray, seen: FloatArray = seen) -> tuple[FloatArray, FloatArray]:
            apparent = weight @ x[:10] / (1.0 + x[10])
            A = np.column_stack([weight, -apparent]) / (1.0 + x[10])
            return A, seen - apparent

        solution = minimise(problem, rows)
        assert solution.status != "NOT_CONVERGED"
        sigma_kg = np.sqrt(solution.information.covariance()[0, 0])
        errors.append((solution.mean[0] - truth[0]) / sigma_kg)
    assert abs(np.mean(errors)) < 0.2 + 4.0 / np.sqrt(DRAWS)
    assert 0.85 < np.sqrt(np.mean(np.square(errors))) < 1.15


def read_prior() -> Prior:
    """Return a prior of two links' errors that share a gain, and of a friction with its own."""
    gains = np.zeros((3, 5))
    gains[:2, 3:], gains[2, 4] = 0.5, 1.0
    root = np.random.default_rng(4).normal(size=(5, 5))
    mean = np.array([0.1, 0.0, 0.3, 0.05, -0.02])
    return Prior(mean, root @ root.T, (), np.arange(3), gains)


def test_information_in_the_readings_scale_is_the_gauss_newton_form_of_the_cost() -> None:
    prior, h = read_prior(), 1e-6
    x = prior.mean + np.array([0.7, -1.2, 0.4, 0.2, 0.1])
    known = prior.at(x)
    slope = [(prior.cost(x + d) - prior.cost(x - d)) / (2 * h) for d in h * np.eye(5)]
    gradient = 2.0 * known.R.T @ (known.R @ x - known.z)
    np.testing.assert_allclose(gradient, slope, rtol=1e-6, atol=1e-8)
    at_mean = prior.at(prior.mean)
    np.testing.assert_allclose(at_mean.covariance(), prior.covariance, atol=1e-10)


def test_a_common_factor_on_masses_and_gains_is_as_probable_at_either_end() -> None:
    """Readings fix the products of gain and errors alone; only the gains' own prior tells."""
    p = 12
    gains = np.zeros((p - 1, p))
    gains[:, -1] = 1.0
    prior = Prior(np.zeros(p), np.diag([1.0] * (p - 1) + [0.2**2]), (), np.arange(p - 1), gains)
    plain = Prior(prior.mean, prior.covariance, ())
    products = np.random.default_rng(6).normal(size=p - 1)

    def at(gain: float) -> FloatArray:
        return np.append(products / (1.0 + gain), gain)

    assert prior.cost(at(0.2)) - prior.cost(at(0.0)) == pytest.approx(1.0, rel=1e-9)
    assert prior.cost(at(-0.2)) - prior.cost(at(0.0)) == pytest.approx(1.0, rel=1e-9)
    # errors that are Gaussian for themselves prefer light links by far
    assert plain.cost(at(0.2)) < plain.cost(at(0.0)) < plain.cost(at(-0.2)) - 3.0
