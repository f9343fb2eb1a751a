"""Conflicts with the prior, group by group: found where one factor for all would hide them."""

import numpy as np

from fsw.estimators.diagnosis import conflict_limit, stated_conflict
from fsw.estimators.model.inertia import report_jacobian
from fsw.estimators.model.problem import Problem
from fsw.estimators.recursive.prior_groups import LARGEST, Widened, groups, in_words, widen
from fsw.messages import FloatArray
from tests.support.estimator_cases import make_problem


def after_data(
    problem: Problem, measured: FloatArray, rows: FloatArray, sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance after data rows x = measured, white noise of sigma."""
    precision = np.linalg.inv(problem.prior_covariance)
    information = precision + rows.T @ rows / sigma**2
    covariance = np.linalg.inv(information)
    right = precision @ problem.prior_mean + rows.T @ measured / sigma**2
    return covariance @ right, 0.5 * (covariance + covariance.T)


def measured_state(problem: Problem, name: str, sigmas: float) -> tuple[FloatArray, FloatArray]:
    """Return the estimate after precise data put one state so many prior sigmas off its prior."""
    k = problem.names.index(name)
    own = float(np.sqrt(problem.prior_covariance[k, k]))
    row = np.eye(len(problem.names))[k : k + 1] / own
    at = problem.prior_mean[k] / own + sigmas
    return after_data(problem, np.array([at]), row, 0.05)


def test_every_state_is_in_one_group() -> None:
    problem = make_problem(("base", "target"), doubt=True)
    states = np.concatenate([group.states for group in groups(problem)])
    assert sorted(states.tolist()) == list(range(len(problem.names)))
    names = [group.name for group in groups(problem)]
    assert names[:3] == ["mass of base", "centre of mass of base", "inertia of base"]
    assert "link.joint3" in names
    assert "torque_scale" in names


def test_a_right_prior_is_left_as_it_is() -> None:
    problem = make_problem(doubt=True)
    prior = (problem.prior_mean, problem.prior_covariance)
    widened, found = widen(problem, prior, measured_state(problem, "target.m", 2.0))
    assert not found
    np.testing.assert_allclose(widened, prior[1], rtol=1e-9, atol=1e-9 * np.abs(prior[1]).max())


def test_a_wrong_mass_widens_the_mass_alone_as_stated() -> None:
    """Ten sigma in one of a hundred states: not found over all states, found in its group."""
    problem = make_problem(doubt=True)
    prior = (problem.prior_mean, problem.prior_covariance)
    estimate = measured_state(problem, "target.m", 8.0)
    widened, found = widen(problem, prior, estimate)
    assert "mass of target" in [group.name for group in found]
    factor = found[0].factor
    assert 6.0 < factor < 10.0
    before, after = (_stated(problem, covariance) for covariance in (prior[1], widened))
    np.testing.assert_allclose(after[0] / before[0], factor, rtol=1e-6)
    if len(found) == 1:
        np.testing.assert_allclose(after[1:] / before[1:], 1.0, rtol=1e-6)
    rest = slice(problem.bodies.stop, None)
    np.testing.assert_array_equal(widened[rest, rest], prior[1][rest, rest])


def _stated(problem: Problem, covariance: FloatArray) -> FloatArray:
    J = report_jacobian(problem.prior_mean[:10])
    return np.sqrt(np.diag(J @ covariance[:10, :10] @ J.T))


def test_a_sensor_is_never_widened_beyond_what_it_can_be() -> None:
    problem = make_problem(doubt=True)
    prior = (problem.prior_mean, problem.prior_covariance)
    estimate = measured_state(problem, "acc_bias.x", 60.0)
    widened, found = widen(problem, prior, estimate)
    assert [(group.name, group.factor, group.of_model) for group in found] == [
        ("acc_bias", LARGEST, True)
    ]
    bias = problem.at("acc_bias")
    ratio = np.sqrt(np.diag(widened)[bias] / np.diag(prior[1])[bias])
    np.testing.assert_allclose(ratio, LARGEST)
    again, still = widen(problem, (prior[0], widened), estimate)
    assert [group.factor for group in still] == [1.0]
    np.testing.assert_allclose(again, widened, rtol=1e-9)


def test_one_distance_over_all_states_would_not_see_it() -> None:
    """The reason for groups: an offset of 6 sigma beside states that the data know and confirm."""
    problem = make_problem(doubt=True)
    rows = np.diag(1.0 / np.sqrt(np.diag(problem.prior_covariance)))
    k = problem.names.index("acc_bias.x")
    measured = rows @ problem.prior_mean
    measured[k] += 6.3
    mean, covariance = after_data(problem, measured, rows, 0.05)
    prior = (problem.prior_mean, problem.prior_covariance)
    distance, dof = stated_conflict(*prior, mean, covariance, 1)
    assert distance < conflict_limit(dof)
    assert [group.name for group in widen(problem, prior, (mean, covariance))[1]] == ["acc_bias"]


def test_words_name_the_quantity_its_size_and_what_to_do() -> None:
    text = in_words([Widened(name="mass of target", sigmas=3.04, factor=3.0, of_model=False)])
    assert "mass of target lies 3.0 sigma" in text
    assert "correct the value, or state a wider sigma" in text
    assert in_words([]) == ""


def test_a_group_of_sensors_or_links_is_named_in_words_with_its_key() -> None:
    def text(name: str) -> str:
        return in_words([Widened(name=name, sigmas=78.2, factor=3.0, of_model=True)])

    assert "joint zeros lies 78.2 sigma" in text("joint_zero")
    assert "(joints[].zero_sigma_rad)" in text("joint_zero")
    assert "inertial unit's place lies" in text("imu_place")
    assert "inertial data of link3 lies" in text("link3")
