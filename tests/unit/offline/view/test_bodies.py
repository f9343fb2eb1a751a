"""Ellipsoids of centres of mass against their closed form, and the truth that is given."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fsw.errors import ConfigError
from offline.view.bodies import (
    LEAST_SEEN,
    com_covariance,
    ellipsoid,
    magnification,
    read_truth,
)

SIGMA_M = np.array([0.01, 0.05, 0.002])
turns = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


@given(turns)
def test_axes_are_three_sigma_along_the_eigenvectors(turn):
    R = Rotation.from_rotvec(turn).as_matrix()
    axes, semi_m = ellipsoid(R @ np.diag(SIGMA_M**2) @ R.T, R)
    assert semi_m == pytest.approx(3.0 * SIGMA_M, rel=1e-6)
    assert axes == pytest.approx(R, abs=1e-6)
    axes, semi_m = ellipsoid(R @ np.diag(SIGMA_M**2) @ R.T, np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1.0)
    rebuilt = axes @ np.diag((semi_m / 3.0) ** 2) @ axes.T
    assert rebuilt == pytest.approx(R @ np.diag(SIGMA_M**2) @ R.T, abs=1e-12)


def test_axes_do_not_jump_from_one_estimate_to_the_next():
    rng = np.random.default_rng(3)
    axes, angles = np.eye(3), []
    for k in range(200):
        R = Rotation.from_rotvec([0.01 * k, 0.02 * k, -0.01 * k]).as_matrix()
        spread = SIGMA_M * rng.uniform(0.5, 2.0, 3)  # their order changes
        found, _ = ellipsoid(R @ np.diag(spread**2) @ R.T, axes)
        angles.append(Rotation.from_matrix(axes.T @ found).magnitude())
        axes = found
    assert max(angles) < 0.1


def test_the_covariance_of_the_centre_is_that_of_draws():
    rng = np.random.default_rng(4)
    pi = np.array([50.0, 10.0, -5.0, 20.0, *np.zeros(6)])
    root = np.zeros((10, 10))
    root[:4, :4] = 0.01 * rng.standard_normal((4, 4))
    draws = pi + rng.standard_normal((200_000, 10)) @ root.T
    found = np.cov((draws[:, 1:4] / draws[:, :1]).T)
    assert com_covariance(pi, root @ root.T) == pytest.approx(found, rel=0.05, abs=1e-9)


@pytest.mark.parametrize(
    ("longest_m", "factor"), [(1.0, 1.0), (0.11, 1.0), (0.06, 2.0), (0.03, 5.0), (0.011, 10.0)]
)
def test_only_what_is_too_small_is_magnified_by_a_round_factor(longest_m, factor):
    assert magnification(np.array([1e-9, longest_m, 1e-9]), 1.0) == factor


@given(st.floats(1e-9, 10.0), st.floats(0.1, 20.0))
def test_a_magnified_ellipsoid_is_seen_and_not_huge(longest_m, reach_m):
    shown_m = longest_m * magnification(np.full(3, longest_m), reach_m)
    assert shown_m >= LEAST_SEEN * reach_m * (1 - 1e-9)
    assert shown_m == longest_m or shown_m <= 2.5 * LEAST_SEEN * reach_m * (1 + 1e-9)


def test_no_uncertainty_is_drawn_all_the_same():
    assert np.isfinite(magnification(np.zeros(3), 1.0))


def test_the_truth_is_read_from_a_result_of_the_bench_or_by_itself(tmp_path):
    path, body = tmp_path / "truth.json", {"mass_kg": 4.0, "com_m": [1.0, 2.0, 3.0]}
    for values in ({"truth": {"target": body}, "valid": True}, {"target": body}):
        path.write_text(json.dumps(values))
        assert read_truth(path, ["target"])["target"].tolist() == [4.0, 1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        "{}",
        '{"target": {"mass_kg": 4.0}}',
        '{"target": {"mass_kg": 4.0, "com_m": [1, 2]}}',
        '{"target": {"mass_kg": NaN, "com_m": [1, 2, 3]}}',
        '{"target": {"mass_kg": "x", "com_m": [1, 2, 3]}}',
        '{"truth": 3}',
    ],
)
def test_a_wrong_truth_is_one_line(tmp_path, text):
    path = tmp_path / "truth.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"--truth .*truth\.json.*com_m") as caught:
        read_truth(path, ["target"])
    assert "\n" not in str(caught.value)
    path.unlink()
    with pytest.raises(ConfigError, match="cannot be read"):
        read_truth(path, ["target"])
