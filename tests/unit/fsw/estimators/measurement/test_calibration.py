"""Arm, zeros and mounting that are not known exactly: derivatives, and what zero sigmas do."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fsw.estimators.batch.run import run_batch
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.calibration import spread_root
from fsw.estimators.model.inertia import frame_change, is_consistent
from fsw.estimators.model.problem import Problem
from tests.support.estimator_cases import (
    BASE,
    TARGET,
    N,
    make_config,
    noisy_blocks,
    parameters,
    random_block,
    robot_model,
)
from tests.support.one_block import mrnea_rows
from tests.support.slopes import (
    assert_row_slopes,
    assert_state_slopes,
    named,
    off_the_prior,
    predicted_fields,
)

KINDS = ("known", "joint_zero", "imu_place", "imu_angle", "torque_scale", "gyro_bias", "gyro_scale")
KINDS = (*KINDS, "gyro_axes")


def problem_and_state(unknown: tuple[str, ...], size: float) -> tuple[Problem, np.ndarray]:
    """Return a problem with everything in doubt, and a state off by some sigmas."""
    problem = build_problem(make_config(unknown, doubt=True), robot_model())
    return problem, off_the_prior(problem, size)


@pytest.mark.parametrize("rate", ["momentum", "measured"])
@pytest.mark.parametrize(("unknown", "size"), [(("target",), 0.0), (("base",), 3.0)])
def test_predictions_derivatives(unknown: tuple[str, ...], size: float, rate: Any) -> None:
    problem, x = problem_and_state(unknown, size)
    block = random_block(2)
    assert_state_slopes(
        lambda x: predict(block, x, problem, rate),
        *(x, 1e-5),
        rtol=0.0,
        of_slope=2e-6,
        rounding=1e-12,
        fields=predicted_fields(rate),
        states=named(problem, *KINDS),
    )


def test_regression_rows_derivatives() -> None:
    """Unit weights (ols): A = -db/dx for every column, whatever the residual.

    The scale's column holds the measured torque, its residual the same over 1 + scale.
    """
    problem, x = problem_and_state(("target",), 2.0)
    x[problem.inertial] = problem.prior_mean[problem.inertial]  # where these rows take H
    block, own = random_block(4), named(problem, *KINDS)
    assert_row_slopes(
        lambda x: mrnea_rows(block, x, problem, "ols"), x, 1e-5, own, of_slope=2e-6, rounding=1e-12
    )


def test_what_is_exact_is_no_state() -> None:
    doubtful, certain = (make_config(doubt=doubt) for doubt in (True, False))
    model = robot_model()
    small, whole = build_problem(certain, model), build_problem(doubtful, model)
    assert len(small.names) == 10 + 7 + 3 + 3
    assert len(whole.names) == len(small.names) + 7 + (7 + 1) * 10 + 7 + 3 + 3 + 3 + 3
    shown = tuple(whole.names[k] for k in whole.published)
    assert shown == build_problem(doubtful, model, exact=True).names
    doubts = ("known", "joint_zero", "imu", "gyro_scale", "gyro_axes")
    assert not [name for name in shown if name.startswith(doubts)]


def test_sigma_of_a_known_base_takes_effect() -> None:
    config = make_config()
    bodies = config.bodies | {"base": make_config(("base",)).bodies["base"]}
    problem = build_problem(config.model_copy(update={"bodies": bodies}), robot_model())
    mass = problem.U[0, problem.bodies.stop :]
    assert np.sqrt(mass @ mass) == pytest.approx(0.5 * BASE.mass_kg)


@pytest.mark.parametrize("body", [BASE, TARGET])
def test_spread_is_of_a_ratio_in_any_frame_and_of_bodies(body: Any) -> None:
    pi, ratio = parameters(body), 0.05
    root = spread_root(pi, ratio)
    covariance = root @ root.T
    assert np.sqrt(covariance[0, 0]) == pytest.approx(ratio * body.mass_kg)
    R = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    T = frame_change(R * np.linalg.det(R), np.array([0.5, -1.0, 2.0]))
    elsewhere = spread_root(T @ pi, ratio)
    np.testing.assert_allclose(
        elsewhere @ elsewhere.T, T @ covariance @ T.T, atol=1e-9 * np.abs(covariance).max() * 100
    )
    draws = np.random.default_rng(1).normal(size=(200, root.shape[1]))
    assert all(is_consistent(pi + root @ draw) for draw in draws)


def test_a_zero_far_off_is_named_and_never_valid() -> None:
    """Joint 4 by 5 degrees, 43 sigma: the bodies come out right, the configuration is wrong."""
    shift = np.zeros(N)
    shift[3] = np.radians(5.0)
    blocks = [replace(b, q_rad=b.q_rad + shift) for b in noisy_blocks("target", 2, 24.0)]
    found = run_batch(make_config(doubt=True), blocks, "fused", ())
    assert found["status"] == "MODEL_MISMATCH"
    assert "joint zeros (joint4): estimated 4" in found["note"]
    right = run_batch(make_config(doubt=True), noisy_blocks("target", 2, 24.0), "fused", ())
    assert right["status"] == "OK"
    assert not right["note"]
