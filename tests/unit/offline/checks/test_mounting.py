"""A mounting that the data contradict, in words."""

import numpy as np
from scipy.spatial.transform import Rotation

from offline.checks.mounting import MOUNTING, contradicted, mounting_words, with_free_mounting
from tests.support.estimator_cases import make_config, make_problem


def test_place_and_attitude_are_named_with_the_value_that_the_data_want() -> None:
    turn = Rotation.from_rotvec([0.0, 0.0, np.deg2rad(30.0)])
    problem = make_problem(("target",), doubt=True)
    x = problem.prior_mean.copy()
    assert not contradicted(problem, x)
    x[problem.at("imu_place")] = [0.4, 0.0, 0.0]
    x[problem.at("imu_angle")] = turn.as_rotvec()
    assert contradicted(problem, x) in ("imu_place", "imu_angle")
    config = make_config(("target",), doubt=True)
    words = mounting_words(config, problem, x)
    q = (turn * Rotation.from_quat(config.imu.mounting.q_BS_xyzw)).as_quat()
    assert "turned by 30 degrees" in words
    assert ", ".join(f"{value:.3f}" for value in q) in words
    assert f"[{problem.p_BS_m[0] + 0.4:.3f}" in words


def test_a_mounting_that_nobody_knows_leaves_the_rest_of_the_prior() -> None:
    problem = make_problem(("target",), doubt=True)
    free = with_free_mounting(problem)
    mounting = np.r_[problem.at("imu_place"), problem.at("imu_angle")]
    rest = np.setdiff1d(np.arange(len(problem.names)), mounting)
    kept = np.ix_(rest, rest)
    assert np.array_equal(free.prior_covariance[kept], problem.prior_covariance[kept])
    assert np.all(np.diag(free.prior_covariance)[mounting] > 9.0)


def test_mounting_is_place_and_attitude_of_the_inertial_unit() -> None:
    assert set(MOUNTING) == {"imu_place", "imu_angle"}
    assert all(group.unknown > group.doubt for group in MOUNTING.values())
