"""The square-root information filter against stacked least squares."""

import numpy as np
import pytest

from fsw.errors import EstimatorError
from fsw.estimators.square_root import SquareRootInformation


def prior(p: int) -> tuple[SquareRootInformation, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(p)
    root = rng.normal(size=(p, p)) + 3 * np.eye(p)
    mean, covariance = rng.normal(size=p), root @ root.T
    return SquareRootInformation.from_prior(mean, covariance), mean, covariance


def test_prior_returns_itself() -> None:
    information, mean, covariance = prior(6)
    np.testing.assert_allclose(information.mean(), mean, rtol=1e-10)
    np.testing.assert_allclose(information.covariance(), covariance, rtol=1e-9, atol=1e-9)
    root = information.covariance_root()
    np.testing.assert_allclose(root @ root.T, covariance, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("p", [1, 10, 33, 36])
def test_updates_are_the_stacked_least_squares(p: int) -> None:
    information, mean, covariance = prior(p)
    rng = np.random.default_rng(1)
    white = np.linalg.solve(np.linalg.cholesky(covariance), np.eye(p))
    rows, rhs = [white], [white @ mean]
    for k in (1, 5, 40, 52):
        A, c = rng.normal(size=(k, p)), rng.normal(size=k)
        information = information.update(A, c)
        rows.append(A)
        rhs.append(c)
    A, c = np.vstack(rows), np.concatenate(rhs)
    np.testing.assert_allclose(information.mean(), np.linalg.lstsq(A, c)[0], rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(information.covariance() @ (A.T @ A), np.eye(p), atol=1e-8)
    assert np.all(np.tril(information.R, -1) == 0.0)


def test_an_update_leaves_the_old_information_alone() -> None:
    information = prior(4)[0]
    R, z = information.R.copy(), information.z.copy()
    information.update(np.ones((3, 4)), np.ones(3))
    assert np.array_equal(information.R, R)
    assert np.array_equal(information.z, z)


def test_condition_number_ignores_units() -> None:
    information = prior(5)[0]
    scaled = SquareRootInformation(information.R * np.array([1, 1e-6, 1e3, 1, 1e9]), information.z)
    expected = information.scaled_condition_number()
    assert scaled.scaled_condition_number() == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("bad", ["singular", "nan", "inf"])
def test_unusable_information_is_an_estimator_error(bad: str) -> None:
    R, z = np.eye(3), np.zeros(3)
    R[1, 1] = {"singular": 0.0, "nan": np.nan, "inf": np.inf}[bad]
    information = SquareRootInformation(R, z)
    for ask in (information.mean, information.covariance, information.covariance_root):
        with pytest.raises(EstimatorError):
            ask()


def test_a_prior_that_is_no_covariance_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        SquareRootInformation.from_prior(np.zeros(2), np.diag([1.0, -1.0]))


def test_a_hundred_thousand_updates_stay_accurate() -> None:
    """Bound: rounding grows at most with the number of updates, 1e5 * 2.2e-16 * 100."""
    rng = np.random.default_rng(0)
    p, truth = 4, np.array([1.0, -2.0, 3.0, 0.5])
    information = SquareRootInformation.from_prior(np.zeros(p), np.eye(p))
    gram, right = np.eye(p), np.zeros(p)
    batch = rng.normal(size=(100, 2, p))
    for k in range(100_000):
        A = batch[k % 100]
        information = information.update(A, A @ truth)
    gram += 1000 * np.einsum("kij,kil->jl", batch, batch)
    right += (gram - np.eye(p)) @ truth
    np.testing.assert_allclose(information.mean(), np.linalg.solve(gram, right), rtol=2e-9)
    np.testing.assert_allclose(information.R.T @ information.R, gram, rtol=2e-9, atol=1e-4)
