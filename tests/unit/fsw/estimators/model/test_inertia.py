"""Conventions against Pinocchio, derivatives against differences, projection against optimality."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.estimators.model import inertia
from fsw.estimators.model.inertia import nearest_consistent
from hil.world.truth import Body
from tests.support.estimator_cases import BODIES, parameters

SEEDS = st.integers(0, 2**32 - 1)


def random_inertia(seed: int) -> pin.Inertia:
    pin.seed(seed % 2**31)
    return pin.Inertia.Random()


def random_consistent(rng: np.random.Generator) -> np.ndarray:
    return inertia.from_log_cholesky(rng.normal(size=10))


def inconsistent_case(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return an inconsistent estimate of a Table 1 body and its badly scaled covariance."""
    rng = np.random.default_rng(seed)
    truth = parameters(BODIES["base" if seed % 2 else "target_leo"])
    while True:
        Q = np.linalg.qr(rng.normal(size=(10, 10)))[0]
        root = (Q * 10.0 ** rng.uniform(-2, 1, 10)) @ Q.T * np.abs(truth + 1)[:, None]
        pi = truth + root @ rng.normal(size=10)
        if not inertia.is_consistent(pi):
            return pi, root @ root.T


def distance(x: np.ndarray, pi: np.ndarray, covariance: np.ndarray) -> float:
    return float((x - pi) @ np.linalg.solve(covariance, x - pi))


@given(SEEDS)
def test_parameters_are_those_of_pinocchio(seed: int) -> None:
    body = random_inertia(seed)
    M = body.inertia
    central = np.array([M[0, 0], M[0, 1], M[0, 2], M[1, 1], M[1, 2], M[2, 2]])
    pi = inertia.to_parameters(body.mass, body.lever, central)
    np.testing.assert_allclose(pi, body.toDynamicParameters(), rtol=1e-12, atol=1e-12)
    mass, com, back = inertia.from_parameters(pi)
    assert mass == body.mass
    np.testing.assert_allclose(com, body.lever, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(back, central, rtol=1e-9, atol=1e-12)


@given(SEEDS)
def test_pseudo_inertia_is_that_of_pinocchio_and_inverts(seed: int) -> None:
    body = random_inertia(seed)
    pi = body.toDynamicParameters()
    P = inertia.pseudo_inertia(pi)
    np.testing.assert_allclose(P, pin.PseudoInertia.FromInertia(body).toMatrix(), atol=1e-12)
    np.testing.assert_allclose(inertia.from_pseudo_inertia(P), pi, rtol=1e-12, atol=1e-13)


@given(SEEDS)
def test_frame_change_is_the_action_of_a_rigid_displacement(seed: int) -> None:
    body = random_inertia(seed)
    M = pin.SE3.Random()
    T = inertia.frame_change(M.rotation, M.translation)
    expected = M.act(body).toDynamicParameters()
    np.testing.assert_allclose(T @ body.toDynamicParameters(), expected, rtol=1e-10, atol=1e-11)


def test_paper_order_exchanges_iyy_and_ixz_and_is_its_own_inverse() -> None:
    names = np.array(inertia.NAMES)
    order = list(inertia.PAPER_ORDER)
    assert list(names[order][4:]) == ["Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz"]
    assert list(names[order][order]) == list(names)


def test_skew_is_the_cross_product() -> None:
    a, b = np.random.default_rng(0).normal(size=(2, 5, 3))
    np.testing.assert_allclose((inertia.skew(a) @ b[..., None])[..., 0], np.cross(a, b), atol=1e-15)


@given(SEEDS)
def test_report_jacobian_is_the_derivative(seed: int) -> None:
    pi = random_consistent(np.random.default_rng(seed))
    J = inertia.report_jacobian(pi)
    expected = np.empty((10, 10))
    for k in range(10):
        d = np.zeros(10)
        d[k] = 1e-5 * pi[0]
        up, down = (inertia.from_parameters(pi + s * d) for s in (1, -1))
        expected[:, k] = (np.hstack(up) - np.hstack(down)) / (2 * d[k])
    np.testing.assert_allclose(J, expected, atol=1e-7 * (1 + np.abs(expected).max()))


@given(SEEDS)
def test_log_cholesky_inverts_and_its_jacobian_is_the_derivative(seed: int) -> None:
    theta = np.random.default_rng(seed).normal(size=10)
    pi = inertia.from_log_cholesky(theta)
    assert inertia.is_consistent(pi)
    np.testing.assert_allclose(inertia.to_log_cholesky(pi), theta, rtol=1e-6, atol=1e-7)
    J = inertia.log_cholesky_jacobian(theta)
    h = 1e-5
    expected = np.stack(
        [
            (inertia.from_log_cholesky(theta + e) - inertia.from_log_cholesky(theta - e)) / (2 * h)
            for e in h * np.eye(10)
        ],
        axis=1,
    )
    np.testing.assert_allclose(J, expected, atol=1e-7 * (1 + np.abs(expected).max()))


@pytest.mark.parametrize("name", sorted(BODIES))
def test_bodies_of_table_1_are_possible_about_their_centre_of_mass_only(name: str) -> None:
    body: Body = BODIES[name]
    assert inertia.is_consistent(parameters(body))
    xx, xy, xz, yy, yz, zz = body.inertia_kg_m2
    about_origin = np.array([body.mass_kg, *(body.mass_kg * np.array(body.com_m))])
    assert not inertia.is_consistent(np.concatenate([about_origin, [xx, xy, yy, xz, yz, zz]]))


def test_parameters_that_are_not_finite_are_not_consistent() -> None:
    pi = parameters(BODIES["base"])
    for bad in (np.nan, np.inf, -np.inf):
        assert not inertia.is_consistent(np.where(np.arange(10) == 4, bad, pi))


def test_consistent_parameters_are_their_own_projection() -> None:
    pi = parameters(BODIES["base"])
    assert nearest_consistent(pi, np.eye(10)) is pi


def test_projection_takes_a_covariance_that_is_singular_within_rounding() -> None:
    """As a square root's product may be: nothing known apart, an eigenvalue rounded below zero."""
    pi, _ = inconsistent_case(0)
    v = np.ones(10) / np.sqrt(10.0)
    covariance = np.eye(10) - (1.0 + 1e-15) * np.outer(v, v)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(covariance)
    assert inertia.is_consistent(nearest_consistent(pi, covariance))


@pytest.mark.parametrize("seed", range(20))
def test_projection_is_consistent_and_nothing_consistent_near_it_is_closer(seed: int) -> None:
    pi, covariance = inconsistent_case(seed)
    x = nearest_consistent(pi, covariance)
    assert inertia.is_consistent(x)
    least = distance(x, pi, covariance)
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(covariance)
    theta = inertia.to_log_cholesky(x)
    J = np.linalg.solve(root, inertia.log_cholesky_jacobian(theta))
    for size in (1e-4, 1e-2, 0.3):
        for _ in range(100):
            straight = x + size * root @ rng.normal(size=10)
            along = inertia.from_log_cholesky(
                theta + np.linalg.lstsq(J, size * rng.normal(size=10), rcond=1e-6)[0].clip(-2, 2)
            )
            for other in (straight, along):
                if inertia.is_consistent(other):
                    assert distance(other, pi, covariance) > least * (1 - 2e-6) - 2e-6


@pytest.mark.parametrize("seed", range(20))
def test_projection_fulfils_the_optimality_conditions(seed: int) -> None:
    """The gradient is -tr(Z E_k) with Z >= 0 and Z P = 0: no consistent point is closer."""
    pi, covariance = inconsistent_case(seed)
    x = nearest_consistent(pi, covariance)
    gradient = np.linalg.solve(covariance, x - pi)
    # dual in the pseudo-inertia's coordinates: gradient_k = <Z, E_k>, Z symmetric
    E = np.stack([inertia.pseudo_inertia(e).ravel() for e in np.eye(10)])
    Z = np.linalg.lstsq(E, gradient, rcond=None)[0].reshape(4, 4)
    scale = np.linalg.cholesky(inertia.pseudo_inertia(x))
    complementarity = np.linalg.eigvalsh(scale.T @ Z @ scale)
    gap = 4e-6 * max(1.0, distance(x, pi, covariance))
    assert complementarity.min() > -gap
    assert complementarity.sum() < gap


def test_projection_of_a_negative_mass_is_consistent() -> None:
    pi = parameters(BODIES["base"])
    covariance = np.diag((0.5 * np.abs(pi) + 1) ** 2)
    assert inertia.is_consistent(nearest_consistent(-pi, covariance))
