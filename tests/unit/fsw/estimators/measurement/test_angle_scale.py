"""Scales of the joints' angles: derivatives, and a reading that a scale makes true."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fsw.config import Config
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from tests.support.estimator_cases import make_config, random_block, robot_model
from tests.support.one_block import mrnea_rows


def scaled_config(*, doubt: bool) -> Config:
    config = make_config(("base", "target"), momentum_sigma_nms=1.0, doubt=doubt)
    joints = tuple(
        joint.model_copy(update={"angle_scale_sigma_ratio": 0.01}) for joint in config.joints
    )
    return config.model_copy(update={"joints": joints})


@pytest.fixture(params=[False, True], ids=["alone", "beside zeros and gains"])
def case(request: Any) -> tuple[Problem, np.ndarray, Block]:
    problem = build_problem(scaled_config(doubt=request.param), robot_model())
    x = problem.prior_mean.copy()
    x[20:] = 0.01 * np.random.default_rng(4).normal(size=len(x) - 20)
    return problem, x, random_block(3)


@pytest.mark.parametrize("rate", ["momentum", "measured"])
def test_predicted_channels_have_the_derivatives_by_a_scale(case: Any, rate: Any) -> None:
    problem, x, block = case
    J = predict(block, x, problem, rate).J
    for k in range(*problem.at("joint_scale").indices(len(x))):
        step = 1e-5 * np.eye(len(x))[k]
        p = [predict(block, x + sign * step, problem, rate) for sign in (1.0, -1.0)]
        channels = [np.concatenate([o.tau_nm, o.f_m_s2, o.w_rad_s], axis=1) for o in p]
        expected = (channels[0] - channels[1]) / 2e-5
        bound = 2e-6 * np.abs(expected).max() + 1e-12 * np.abs(channels[0]).max() / 1e-5
        assert np.abs(J[:, :, k] - expected).max() <= bound, problem.names[k]


def test_rows_of_mrnea_have_the_derivatives_by_a_scale(case: Any) -> None:
    problem, x, block = case
    x[problem.inertial] = problem.prior_mean[problem.inertial]  # at which "ols" has its gains
    A = mrnea_rows(block, x, problem, "ols").A
    for k in range(*problem.at("joint_scale").indices(len(x))):
        step = 1e-5 * np.eye(len(x))[k]
        b = [mrnea_rows(block, x + sign * step, problem, "ols").b for sign in (1.0, -1.0)]
        expected = (b[1] - b[0]) / 2e-5
        bound = 2e-6 * np.abs(expected).max() + 1e-12 * np.abs(b[0]).max() / 1e-5
        assert np.abs(A[:, k] - expected).max() <= bound, problem.names[k]


def test_readings_divided_by_a_scale_predict_what_true_ones_do(case: Any) -> None:
    problem, x, block = case
    x[problem.at("joint_scale")] = 0.0
    true = predict(block, x, problem)
    own = np.linspace(-0.01, 0.02, block.q_rad.shape[1])
    names = "q_rad", "qd_rad_s", "qdd_rad_s2"
    read = replace(block, **{name: getattr(block, name) / (1.0 + own) for name in names})
    x[problem.at("joint_scale")] = own
    found = predict(read, x, problem)
    for name in ("tau_nm", "f_m_s2", "w_rad_s"):
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=1e-9, abs=1e-12)
