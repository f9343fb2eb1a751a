"""Profile-widened covariance on functions whose shape is known."""

import numpy as np
import pytest

from fsw.estimators.batch.curvature import widen

PRIOR = np.eye(2)
NAMES = ("a", "b")


def profile_of(cost, path):
    """Profile along the first state: the second is at path(a)."""

    def profile(normal, value, _start):
        a = value / normal[0]
        x = np.array([a, path(a)])
        return x, cost(x)

    return profile


def test_a_gaussian_is_left_as_it_is():
    covariance = np.diag([0.25, 1e-4])
    profile = profile_of(lambda x: x[0] ** 2 / 0.25 + x[1] ** 2 / 1e-4, lambda _a: 0.0)
    found = widen(np.zeros(2), 0.0, covariance, PRIOR, NAMES, 2, profile)
    assert found.covariance == pytest.approx(covariance)
    assert found.bounded
    assert not found.note


def test_a_bent_valley_is_covered_by_the_widened_sigma():
    covariance = np.diag([0.25, 1e-4])
    profile = profile_of(
        lambda x: x[0] ** 2 / 0.25 + (x[1] - x[0] ** 2) ** 2 / 1e-4, lambda a: a**2
    )
    found = widen(np.zeros(2), 0.0, covariance, PRIOR, NAMES, 2, profile)
    assert "a" in found.note
    for a in (-1.5, -0.5, 0.5, 1.0, 1.5):  # points of the valley up to three sigma
        d = np.array([a, a**2])
        assert d @ np.linalg.solve(found.covariance, d) <= 1.5 * a**2 / 0.25


def test_a_side_that_stays_flat_is_told():
    covariance = np.diag([0.25, 1e-4])
    profile = profile_of(lambda x: 1.0 - np.exp(-(x[0] ** 2)), lambda _a: 0.0)
    found = widen(np.zeros(2), 0.0, covariance, PRIOR, NAMES, 2, profile)
    assert not found.bounded
    assert "the data do not limit a" in found.note


def test_a_well_known_axis_is_not_looked_at():
    def never(*_arguments):
        raise AssertionError

    found = widen(np.zeros(2), 0.0, 1e-4 * np.eye(2), PRIOR, NAMES, 2, never)
    assert found.covariance == pytest.approx(1e-4 * np.eye(2))
