"""Zeros and walks of integrated angles: derivatives by finite differences, noise of bridges."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.walks import STEPS
from fsw.messages import Block
from tests.support.estimator_cases import NODES, N, random_block, robot_model
from tests.support.one_block import fused_rows, mrnea_rows
from tests.support.slopes import assert_row_slopes, assert_state_slopes, named, predicted_fields
from tests.support.speed_cases import TURNING, speed_config


def case(unknown: tuple[str, ...] = ("target",), share: float = 0.37) -> tuple[Problem, Block]:
    problem = build_problem(speed_config(np.zeros(N), unknown=unknown), robot_model())
    assert problem.walks is not None
    walk = np.zeros(N)
    walk[list(TURNING)] = share * problem.walks.knots_rad2[:, -1]
    covariance = np.stack([1e-6 * np.eye(3 * NODES)] * N)
    return problem, replace(random_block(2), walk_rad2=walk, cov_joint=covariance)


def state(problem: Problem) -> np.ndarray:
    x = problem.prior_mean.copy()
    for k in (problem.at("joint_zero"), problem.at("joint_walk")):
        x[k] += 3e-3 * np.random.default_rng(k.start).normal(size=k.stop - k.start)
    return x


@pytest.mark.parametrize("rate", ["momentum", "measured"])
@pytest.mark.parametrize("unknown", [("target",), ("base",)])
def test_predictions_derivatives(unknown: tuple[str, ...], rate: Any) -> None:
    problem, block = case(unknown)
    assert_state_slopes(
        lambda x: predict(block, x, problem, rate),
        *(state(problem), 1e-5),
        rtol=0.0,
        of_slope=2e-6,
        rounding=1e-12,
        fields=predicted_fields(rate),
        states=named(problem, "joint_zero", "joint_w"),
    )


def test_steps_behind_the_walk_do_nothing_and_those_before_it_all() -> None:
    problem, block = case(share=0.5)
    J = predict(block, state(problem), problem).J
    zero = np.arange(J.shape[2])[problem.at("joint_zero")][list(TURNING)]
    steps = np.arange(J.shape[2])[problem.at("joint_walk")].reshape(len(TURNING), -1)
    half = steps.shape[1] // 2
    for own, row in zip(zero, steps, strict=True):
        np.testing.assert_allclose(J[:, :, row[: half - 1]], J[:, :, [own]] + 0.0 * row[: half - 1])
        assert not J[:, :, row[half + 1 :]].any()


def test_regression_rows_derivatives() -> None:
    problem, block = case()
    x, own = state(problem), named(problem, "joint_zero", "joint_w")
    assert_row_slopes(
        lambda x: mrnea_rows(block, x, problem, "ols"), x, 1e-5, own, of_slope=2e-6, rounding=1e-12
    )


def test_a_bridge_is_noise_of_the_angle() -> None:
    """Between knots the rows weigh less than on one, by the angle's gain alone."""
    weights = []
    for share in (0.5, 0.5 + 0.5 / STEPS):  # on a knot, and half way to the next
        problem, block = case(share=share)
        root = fused_rows(block, problem.prior_mean, problem).root
        assert root is not None
        weights.append(root @ root.T)
    more = np.linalg.eigvalsh(weights[1] - weights[0])
    assert more[-1] > 1e-7
    assert more[0] > -1e-9 * more[-1]
    assert np.sum(more > 1e-9 * more[-1]) == len(TURNING)
