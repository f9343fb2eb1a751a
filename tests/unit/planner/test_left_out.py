"""Costs of what is left out: two routes to one number, closed forms, and plain least squares."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.config import Config
from fsw.estimators.conditioning.polynomial import gauss_nodes
from fsw.estimators.measurement.row_functions import row_function, stack
from fsw.estimators.model.building import build_problem
from planner import left_out
from planner.nominal import nominal_motion
from tests.support.estimator_cases import make_config, robot_model

OFFSET_NM = 0.03


def with_offset(config: Config, sigma_nm: float, joint: int = 3) -> Config:
    """Return a configuration in which one joint alone has a torque offset."""
    data = config.model_dump()
    for k, own in enumerate(data["joints"]):
        own["torque_offset_sigma_nm"] = sigma_nm if k == joint else 0.0
    return Config.model_validate(data)


@pytest.fixture(scope="module")
def case():
    config = with_offset(make_config(), OFFSET_NM)
    problem = build_problem(config, robot_model())
    motion = replace(nominal_motion(config, problem.model), duration_s=16.0)
    blocks = left_out.blocks_along(config, problem, motion)
    return config, problem, blocks


def test_columns_and_prediction_of_an_offset_tell_the_same_cost(case):
    config, problem, blocks = case
    names = list(problem.names)
    own = names.index("torque_offset.joint4")
    states = np.arange(problem.at("torque_offset").start, problem.at("torque_offset").stop)
    by_columns = left_out.Information(problem, "fused", blocks).without(
        states, np.empty(0, np.int64)
    )
    truth = problem.prior_mean.copy()
    truth[own] = OFFSET_NM
    values = left_out.channels(blocks, replace(problem, prior_mean=truth))
    without = build_problem(with_offset(config, 0.0), problem.model)
    by_prediction = left_out.Information(without, "fused", blocks).shift(
        left_out.measured(blocks, values)
    )
    np.testing.assert_allclose(
        by_columns.error[:10], np.abs(by_prediction.error[:10]), rtol=1e-6, atol=1e-9
    )
    np.testing.assert_allclose(by_columns.sigma[:10], by_prediction.sigma[:10], rtol=1e-6)
    assert by_columns.error[0] > by_columns.sigma[0]


def test_sigma_and_cost_are_those_of_the_normal_equations(case):
    _, problem, blocks = case
    rows = stack(row_function("fused", "eiv", problem), blocks, problem.prior_mean)
    A = np.concatenate([own.A for own in rows])
    states = np.arange(problem.at("torque_offset").start, problem.at("torque_offset").stop)
    kept = np.setdiff1d(np.arange(A.shape[1]), states)
    prior = problem.prior_covariance
    unit = np.sqrt(np.diag(prior))[kept]  # scaled: the units of masses and biases lie far apart
    scaled = A[:, kept] * unit
    information = scaled.T @ scaled + np.linalg.inv(
        prior[np.ix_(kept, kept)] / np.outer(unit, unit)
    )
    P = np.linalg.inv(information)
    gain = unit[:, None] * (P @ scaled.T @ A[:, states])
    error = np.sqrt(np.diag(gain @ prior[np.ix_(states, states)] @ gain.T))
    found = left_out.Information(problem, "fused", blocks).without(states, np.empty(0, np.int64))
    np.testing.assert_allclose(found.sigma[kept], unit * np.sqrt(np.diag(P)), rtol=1e-4)
    np.testing.assert_allclose(found.error[:10], error[:10], rtol=1e-3, atol=1e-9)


def test_a_model_s_own_channels_cost_nothing(case):
    _, problem, blocks = case
    shift = left_out.Information(problem, "fused", blocks).shift(blocks)
    assert np.abs(shift.error / shift.sigma).max() < 1e-6


def test_the_derivative_of_a_cubic_is_exact():
    half_s = 0.2
    t = half_s * gauss_nodes(4)[:, None]
    cubic = np.hstack([t**3 - 2.0 * t, 5.0 + 0.0 * t])
    got = left_out.derivative(cubic, half_s)
    np.testing.assert_allclose(got, np.hstack([3.0 * t**2 - 2.0, 0.0 * t]), atol=1e-12)
    ramp = left_out.late(np.hstack([7.0 * t, 7.0 * t]), np.array([0.01, 0.0]), half_s)
    np.testing.assert_allclose(ramp, np.hstack([7.0 * (t - 0.01), 7.0 * t]), atol=1e-12)
