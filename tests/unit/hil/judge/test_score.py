"""Scores in cases whose answer is known."""

import numpy as np
import pinocchio as pin
import pytest

from hil.judge.bound import Sensors
from hil.judge.endeffector import Verification
from hil.judge.floating import FloatingRobot
from hil.judge.score import (
    BOUND_RATE_HZ,
    Case,
    bound_sigmas,
    comparison,
    expected_tool_error,
    nees_words,
    normalised_error_squared,
    prior_information,
    result_from,
    rows,
    score,
    stacked,
    table,
    table_header,
)
from hil.run.flight_sensors import bound_sensors
from hil.world.inertia import pi_jacobian, pi_of, report_of
from hil.world.prior import Prior, draw_prior
from hil.world.scenario import load, mapping_from
from hil.world.spline import JointSpline

SENSORS = Sensors(
    joint_rate_hz=500.0,
    torque_noise_nm=np.full(3, 0.05),
    torque_offset_sigma_nm=np.full(3, 0.1),
    imu_rate_hz=500.0,
    gyro_noise_rad_s=1e-3,
    gyro_bias_sigma_rad_s=2e-5,
    acc_noise_m_s2=1e-2,
    acc_bias_sigma_m_s2=1e-2,
    p_BS_m=np.array([0.2, -0.1, 0.3]),
    R_BS=pin.exp3(np.array([0.2, 0.5, -0.4])),
)


@pytest.fixture
def case(small_robot, small_bodies, swing):
    robot = small_robot("target")
    truth = {body: report_of(pi) for body, pi in small_bodies.items()}
    priors = {"target": Prior(report=truth["target"] * 1.3, sigma=np.abs(truth["target"]) * 0.5)}
    motion = swing(np.arange(0.0, 6.0, 0.04))
    return Case(
        unknown=("target",),
        truth=truth,
        priors=priors,
        robot=robot,
        verification=Verification(robot, lambda t: swing(t)[:2], 6.0),
        bound_sigmas=bound_sigmas(robot, SENSORS, truth, priors, motion, 25.0),
        true_bound_sigmas=bound_sigmas(robot, SENSORS, truth, priors, motion, 25.0),
    )


def result_at(case, x, covariance):
    return result_from(case.unknown, x, covariance, valid=True, reason="")


def test_the_true_model_scores_no_error(case):
    outcome = score(case, result_at(case, case.x_truth, np.diag((0.01 * case.x_truth) ** 2)))
    assert outcome["nees"] == 0.0
    assert outcome["dof"] == 10
    assert all(value == 0.0 for value in outcome["ee_error"].values())
    assert outcome["ee_error_prior"]["mean_position_m"] > 0
    assert outcome["ee_error_expected"]["mean_position_m"] > 0
    np.testing.assert_allclose(
        rows(outcome["estimate"]["target"]), rows(outcome["truth"]["target"]), rtol=1e-10
    )


def test_nees_of_draws_from_the_covariance_is_the_number_of_parameters():
    rng = np.random.default_rng(5)
    root = rng.standard_normal((10, 10)) * np.logspace(-3, 3, 10)[:, None]
    P = root @ root.T
    draws = rng.standard_normal((2000, 10)) @ root.T
    mean = np.mean([normalised_error_squared(e, P) for e in draws])
    # standard deviation of the mean of 2000 chi-squared(10): sqrt(20/2000) = 0.1
    assert mean == pytest.approx(10.0, abs=0.5)


def test_prior_information_inverts_the_propagated_covariance():
    report = np.array([400, 0.7, 0.5, 0.4, 250, 5, 12, 250, -8, 250.0])
    prior = Prior(report=report, sigma=0.5 * np.abs(report))
    J = pi_jacobian(report)
    covariance = J @ np.diag(prior.sigma**2) @ J.T
    np.testing.assert_allclose(prior_information(prior) @ covariance, np.eye(10), atol=1e-8)


def test_without_data_the_bound_is_the_prior(small_robot, small_bodies):
    truth = {body: report_of(pi) for body, pi in small_bodies.items()}
    priors = {"target": Prior(report=truth["target"], sigma=0.1 * np.abs(truth["target"]))}
    still = tuple(np.zeros((1, 3)) for _ in range(3))
    sigmas = bound_sigmas(small_robot("target"), SENSORS, truth, priors, still, 25.0)
    np.testing.assert_allclose(sigmas["target"], priors["target"].sigma, rtol=1e-6)


def test_the_bound_lies_below_the_prior_and_data_narrow_the_mass(case):
    sigma = case.bound_sigmas["target"]
    assert np.all(sigma > 0)
    assert np.all(sigma <= 1.05 * case.priors["target"].sigma)
    assert sigma[0] < 0.05 * case.priors["target"].sigma[0]


def test_expected_tool_error_grows_with_the_covariance(case):
    small = np.diag((1e-4 * case.x_truth) ** 2)
    once = expected_tool_error(case, result_at(case, case.x_truth, small)).summary()
    twice = expected_tool_error(case, result_at(case, case.x_truth, 4 * small)).summary()
    for key, value in once.items():
        assert twice[key] == pytest.approx(2 * value, rel=0.02)  # linear for small errors


def test_comparison_gives_the_relative_mass_error(case):
    x = case.x_truth.copy()
    x[0] *= 0.5
    other = comparison(case, result_at(case, x, np.diag((0.01 * case.x_truth) ** 2)))
    assert other["mass_error_ratio"]["target"] == pytest.approx(-0.5)


def test_the_table_shows_truth_prior_estimate_sigma_and_error(case):
    covariance = np.diag((0.01 * case.x_truth) ** 2)
    outcome = score(case, result_at(case, case.x_truth, covariance))
    lines = table(outcome, "target")
    assert len(lines) == 10
    assert all(len(line) == len(table_header(outcome)) for line in lines)
    assert lines[0][1:3] == ("60", "78")
    outcome["ols"] = {"estimate": {"target": mapping_from(case.truth["target"])}}
    assert all(len(line) == len(table_header(outcome)) for line in table(outcome, "target"))


def test_stacked_is_in_the_order_of_the_unknown(case):
    x = stacked(case.truth, ("base", "target"))
    np.testing.assert_allclose(x[10:], pi_of(case.truth["target"]))


@pytest.mark.parametrize("name", ["target_leo", "target_geo"])
def test_the_bound_of_a_run_does_not_depend_on_the_rate_of_its_sum(name):
    scenario = load(name)
    pis = {body: pi_of(report) for body, report in scenario.truth.items()}
    robot = FloatingRobot(scenario.urdf, scenario.tool_frame, pis, scenario.unknown)
    priors = {body: draw_prior(scenario.truth[body], 0, body) for body in scenario.unknown}
    spline = JointSpline.load(scenario.identification)

    def bound(rate_hz):
        motion = spline.evaluate(np.arange(0.0, spline.duration_s, 1.0 / rate_hz))
        sensors = bound_sensors(scenario, robot.n)
        return bound_sigmas(robot, sensors, scenario.truth, priors, motion, rate_hz)["target"]

    assert np.allclose(bound(BOUND_RATE_HZ), bound(50.0), rtol=1e-7, atol=0.0)


def test_a_nees_stands_beside_its_band():
    """The 2.5 and 97.5 % points of chi-square with 10 degrees: 3.247 and 20.483 (tables)."""
    told = nees_words({"nees": 16.94, "dof": 10})
    assert told == "NEES 16.9 for 10 parameters (95 % of right runs: 3.2 to 20.5)"
