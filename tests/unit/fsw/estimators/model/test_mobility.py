"""Covariance by way of the base's mobility: exact where straight, right where bent."""

import numpy as np
import pytest
from scipy.optimize import minimize

from fsw.config import Config
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.inertia import report_jacobian
from fsw.estimators.model.mobility import (
    by_mobility,
    from_mobility,
    is_bent,
    longer_sides,
    mobility_jacobian,
    to_mobility,
)
from tests.support.estimator_cases import BASE, make_config, parameters, robot_model
from tests.support.thruster_cases import config_with_thrusters

PI = parameters(BASE)
WIDE = np.full(10, np.inf)  # a prior that says nothing


def covariance_of(relative: float) -> np.ndarray:
    """Return the covariance in pi of independent relative errors of the mobility."""
    J = np.linalg.solve(mobility_jacobian(PI), np.diag(relative * np.abs(to_mobility(PI))))
    return J @ J.T


def test_mobility_and_back():
    assert from_mobility(to_mobility(PI)) == pytest.approx(PI, rel=1e-12)


def test_jacobian_matches_finite_differences():
    J = mobility_jacobian(PI)
    for k in range(10):
        d = np.zeros(10)
        d[k] = 1e-4 * max(1.0, abs(PI[k]))
        slope = (to_mobility(PI + d) - to_mobility(PI - d)) / (2 * d[k])
        assert J[:, k] == pytest.approx(slope, rel=1e-6, abs=1e-12)


def test_a_small_covariance_comes_back_as_it_is():
    covariance = covariance_of(1e-6)
    mapped = by_mobility(PI, covariance, slice(0, 10))
    assert not mapped.bent
    assert mapped.impossible == 0.0
    scale = np.sqrt(np.diag(covariance))
    assert mapped.covariance / np.outer(scale, scale) == pytest.approx(
        covariance / np.outer(scale, scale), abs=1e-4
    )


def test_other_states_keep_their_covariance():
    covariance = np.zeros((12, 12))
    covariance[2:, 2:] = covariance_of(0.05)
    covariance[:2, :2] = np.diag([4.0, 9.0])
    x = np.concatenate([[1.0, 2.0], PI])
    mapped = by_mobility(x, covariance, slice(2, 12))
    assert mapped.covariance[:2, :2] == pytest.approx(np.diag([4.0, 9.0]), abs=1e-6)


def test_the_variance_of_a_gaussian_mobility_is_the_one_published():
    """1/m Gaussian with sigma 10 %: var(1/u) by quadrature, 3 sigma of 2000 draws allowed."""
    covariance = covariance_of(0.1)
    mapped = by_mobility(PI, covariance, slice(0, 10))
    points, weights = np.polynomial.hermite_e.hermegauss(40)
    u = 1.0 + 0.1 * points
    kept = u > 0.3  # beyond 7 sigma the inverse has no moments
    weights /= weights.sum()
    mean = float(weights[kept] @ (1.0 / u[kept]))
    exact = float(weights[kept] @ (1.0 / u[kept] - mean) ** 2) * PI[0] ** 2
    assert mapped.bent
    assert mapped.covariance[0, 0] == pytest.approx(exact, rel=0.1)
    assert mapped.covariance[0, 0] > 1.02 * covariance[0, 0]


def test_errors_of_a_gaussian_mobility_have_the_degrees_of_freedom_as_mean_square():
    """Estimates scattered in the mobility, judged in pi: right by way of it, not without it."""
    rng = np.random.default_rng(1)
    size, plain, by_way = 0.1 * np.abs(to_mobility(PI)), [], []
    for _ in range(60):
        estimate = from_mobility(to_mobility(PI) + size * rng.standard_normal(10))
        J = np.linalg.solve(mobility_jacobian(estimate), np.diag(size))
        covariance, e = J @ J.T, estimate - PI
        plain.append(e @ np.linalg.solve(covariance, e))
        published = by_mobility(estimate, covariance, slice(0, 10)).covariance
        by_way.append(e @ np.linalg.solve(published, e))
    assert 8.9 <= np.mean(by_way) <= 11.2  # 95 % band of 60 seeds
    assert np.mean(plain) > 11.2


def test_a_gaussian_that_is_no_body_says_so():
    assert not by_mobility(PI, covariance_of(1.0), slice(0, 10)).holds


def test_it_is_the_covariance_of_draws_in_all_states():
    """Base correlated with seven other states: plain Monte Carlo of 200 000 draws, within 6 %."""
    rng = np.random.default_rng(4)
    slope, size = mobility_jacobian(PI), 0.04 * np.abs(to_mobility(PI))
    J = np.eye(17)
    J[3:13, 3:13] = np.linalg.solve(slope, np.diag(size))
    mixed = rng.standard_normal((17, 17)) / 4.0 + np.eye(17)
    covariance = J @ mixed @ mixed.T @ J.T
    mean = np.concatenate([np.zeros(3), PI, np.zeros(4)])
    draws = rng.standard_normal((200_000, 17)) @ np.linalg.cholesky(covariance).T
    draws[:, 3:13] = from_mobility(to_mobility(PI)[:, None] + slope @ draws[:, 3:13].T).T - PI
    moments = np.cov(draws.T)
    mapped = by_mobility(mean, covariance, slice(3, 13))
    assert mapped.bent
    assert mapped.holds
    ratio = np.linalg.solve(moments, mapped.covariance)
    assert np.linalg.eigvals(ratio).real == pytest.approx(np.ones(17), abs=0.06)


def test_what_is_no_body_is_told_by_its_principal_moments():
    rng = np.random.default_rng(5)
    J = mobility_jacobian(PI)
    size = np.diag(0.5 * np.abs(to_mobility(PI)))
    covariance = np.linalg.solve(J, size) @ np.linalg.solve(J, size).T
    drawn = to_mobility(PI)[:, None] + size @ rng.standard_normal((10, 20_000))
    xx, xy, xz, yy, yz, zz = drawn[4:]
    inverse = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz]).T.reshape(-1, 3, 3)
    moments = 1.0 / np.linalg.eigvalsh(inverse)[:, ::-1]
    body = (drawn[0] > 0.0) & np.all(moments > 0.0, axis=1)
    body &= moments[:, 2] < moments[:, 0] + moments[:, 1]
    told = by_mobility(PI, covariance, slice(0, 10)).impossible
    assert told == pytest.approx(1.0 - np.mean(body), abs=0.03)
    assert 0.1 < told < 0.9


@pytest.mark.parametrize("relative", [0.1, 0.15, 0.25])
def test_sigma_of_a_weakly_known_mass_is_that_of_its_heavier_side(relative):
    """1/m straight: three sigma up are m / (1 - 3 r) - m, closed form; the centre has two sides."""
    covariance = covariance_of(relative)
    sigma = longer_sides(PI, covariance, WIDE)
    assert sigma[0] == pytest.approx(PI[0] * relative / (1.0 - 3.0 * relative), rel=1e-9)
    assert sigma[1:4] == pytest.approx(relative * np.abs(to_mobility(PI)[1:4]), rel=1e-9)


def test_the_longer_side_of_an_inertia_is_its_profile():
    """Largest Ixx on the ellipsoid of three sigma in the mobility, found by a general optimiser."""
    covariance = covariance_of(0.085)
    root = np.linalg.cholesky(mobility_jacobian(PI) @ covariance @ mobility_jacobian(PI).T)

    def ixx(z):
        return from_central(to_mobility(PI) + root @ z)[0]

    at = np.linalg.lstsq(root, -3.0 * root @ np.eye(10)[4], rcond=None)[0]
    best = minimize(
        lambda z: -ixx(z),
        at,
        method="SLSQP",
        constraints={"type": "ineq", "fun": lambda z: 9.0 - z @ z},
    )
    longest = -best.fun - from_central(to_mobility(PI))[0]
    assert longer_sides(PI, covariance, WIDE)[4] == pytest.approx(longest / 3.0, rel=0.05)


def from_central(mobility):
    """Return the central inertia, xx xy xz yy yz zz."""
    xx, xy, xz, yy, yz, zz = mobility[4:]
    inverse = np.linalg.inv([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return inverse[np.triu_indices(3)]


def test_a_base_that_is_known_well_keeps_its_sigma():
    covariance = covariance_of(0.05)
    J = report_jacobian(PI)
    assert np.array_equal(
        longer_sides(PI, covariance, WIDE), np.sqrt(np.diag(J @ covariance @ J.T))
    )


def test_the_longer_side_is_no_longer_than_the_prior_says():
    covariance = covariance_of(0.3)  # 1/m reaches far towards zero within three sigma
    least = longer_sides(PI, covariance, np.zeros(10))
    assert np.array_equal(
        least, np.sqrt(np.diag(report_jacobian(PI) @ covariance @ report_jacobian(PI).T))
    )
    assert longer_sides(PI, covariance, np.full(10, 0.5 * PI[0]))[0] == pytest.approx(0.5 * PI[0])
    assert longer_sides(PI, covariance, WIDE)[0] > 2.0 * PI[0]


@pytest.mark.parametrize(
    ("config", "method", "bent"),
    [
        (make_config(("base",)), "fused", True),
        (make_config(("base",)), "cm", False),  # rates alone: no force to divide by
        (make_config(("target",)), "fused", False),
        (config_with_thrusters(("base",), thruster={"force_sigma_ratio": 0.0}), "fused", True),
        (config_with_thrusters(("base",), thruster={"force_sigma_ratio": 0.03}), "fused", False),
    ],
)
def test_pi_is_bent_but_for_thrusters_whose_force_is_sought(
    config: Config, method: str, bent: bool
) -> None:
    assert is_bent(build_problem(config, robot_model()), method) is bent
