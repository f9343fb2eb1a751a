"""Rotor inertia and ripple: derivatives in every method, noise, configuration."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fsw.config import Config
from fsw.errors import ConfigError
from fsw.estimators.conditioning.polynomial import gauss_nodes
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.motion_noise import residual_covariance
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from tests.support.estimator_cases import (
    NODES,
    N,
    make_config,
    noisy_angles,
    random_block,
    robot_model,
)
from tests.support.one_block import energy_rows, mrnea_rows
from tests.support.slopes import (
    TORQUE,
    assert_motion_slopes,
    assert_row_slopes,
    assert_state_slopes,
    named,
    off_the_prior,
)

PERIODS = (2.0, 160.0)
KEYS = {
    "torque": "motor_current",
    "rotor_inertia_sigma_kg_m2": 0.4,
    "ripple_sigma_nm": 0.3,
    "ripple_periods": PERIODS,
    "torque_scale_sigma_ratio": 0.1,
}


def with_joints(config: Config, *joints: int, **keys: Any) -> Config:
    data = [
        joint.model_dump() | (keys if k in joints else {}) for k, joint in enumerate(config.joints)
    ]
    return config.with_sections(joints=data)


def problem_and_state(*, doubt: bool = True, everywhere: bool = True) -> tuple[Problem, np.ndarray]:
    joints = range(N) if everywhere else (1, 4)
    config = with_joints(make_config(doubt=doubt), *joints, **KEYS)
    problem = replace(build_problem(config, robot_model()), angles_are_noisy=True)
    x = off_the_prior(problem)
    x[problem.inertial] = problem.prior_mean[problem.inertial]
    return problem, x


def own_columns(problem: Problem) -> list[int]:
    return named(problem, "rotor_inertia", "ripple", "torque_scale", "joint_zero")


@pytest.mark.parametrize("everywhere", [True, False])
@pytest.mark.parametrize("rate", ["momentum", "measured"])
def test_predictions_derivatives_by_the_state(rate: Any, everywhere: bool) -> None:
    problem, x = problem_and_state(everywhere=everywhere)
    block, own = noisy_angles(), own_columns(problem)
    assert len(own) >= (N if everywhere else 2) * 5
    assert_state_slopes(
        lambda x: predict(block, x, problem, rate),
        *(x, 1e-6),
        rtol=0.0,
        of_slope=1e-5,
        absolute=1e-9,
        fields=TORQUE,
        states=own,
    )


@pytest.mark.parametrize(
    ("key", "gain"), [("q_rad", "D_q"), ("qd_rad_s", "D_qd"), ("qdd_rad_s2", "D_qdd")]
)
def test_predictions_derivatives_by_the_motion(key: str, gain: str) -> None:
    problem, x = problem_and_state()
    assert_motion_slopes(lambda block: predict(block, x, problem), noisy_angles(), key, gain)


def test_noise_of_acceleration_counts_through_the_rotor() -> None:
    """The residuals' covariance against 20,000 draws of the joints' motion."""
    problem, x = problem_and_state(doubt=False)
    block = replace(noisy_angles(), cov_tau=np.zeros((N, NODES, NODES)))
    s, use = BlockStack((block,)), np.r_[np.ones(N, bool), np.zeros(6, bool)]
    small = replace(block, cov_joint=1e-4 * block.cov_joint)
    s = BlockStack((small,))
    S = residual_covariance(s, predict(s, x, problem, "momentum"), use, "momentum")[0]
    rng = np.random.default_rng(8)
    roots = np.linalg.cholesky(small.cov_joint + 1e-18 * np.eye(3 * NODES))
    count, drawn = 400, []
    for _ in range(count):
        e = (roots @ rng.normal(size=(N, 3 * NODES, 1)))[:, :, 0].reshape(N, 3, NODES)
        moved = replace(
            block,
            qd_rad_s=block.qd_rad_s + e[:, 0].T,
            qdd_rad_s2=block.qdd_rad_s2 + e[:, 1].T,
            q_rad=block.q_rad + e[:, 2].T,
        )
        drawn.append(predict(moved, x, problem, "momentum").tau_nm.ravel())
    white = np.linalg.solve(np.linalg.cholesky(S), (np.array(drawn) - np.mean(drawn, 0)).T)
    # variance of each of 28 white values: 1 within 5 sigma of a sample variance of 400 draws
    assert np.abs(np.mean(white**2, axis=1) - 1.0).max() < 5.0 * np.sqrt(2.0 / count)


def test_rows_of_the_regression_and_of_energy() -> None:
    problem, x = problem_and_state(doubt=False)
    block, own = random_block(4), named(problem, "rotor", "ripple")
    quiet = replace(block, cov_tau=1e12 * block.cov_tau)
    spans = replace(quiet, t_ns=np.rint(2e8 * (1.0 + gauss_nodes(NODES))).astype(np.int64))
    assert_row_slopes(lambda x: mrnea_rows(block, x, problem, "ols"), x, 1e-6, own, of_slope=1e-5)
    assert_row_slopes(lambda x: energy_rows(spans, x, problem), x, 1e-6, own, of_slope=1e-4)


def test_motor_current_is_wide_by_default_and_says_so() -> None:
    plain = make_config()
    data = plain.joints[0].model_dump(exclude_unset=True) | {"torque": "motor_current"}
    data.pop("torque_scale_sigma_ratio")
    joint = plain.with_sections(joints=[data, *[j.model_dump() for j in plain.joints[1:]]]).joints[
        0
    ]
    assert joint.torque_limit_nm == 100.0
    assert joint.friction_coulomb_sigma_nm == pytest.approx(10.0)
    assert joint.friction_viscous_sigma_nms_rad == pytest.approx(10.0)
    assert joint.rotor_inertia_sigma_kg_m2 == pytest.approx(2.0)
    assert joint.torque_scale_sigma_ratio == pytest.approx(0.1)
    stated = with_joints(plain, 0, torque="motor_current", friction_coulomb_sigma_nm=0.25)
    assert stated.joints[0].friction_coulomb_sigma_nm == 0.25


@pytest.mark.parametrize(
    ("keys", "word"),
    [
        ({"ripple_periods": (4.0,)}, "ripple_sigma_nm"),
        ({"ripple_sigma_nm": 0.1}, "ripple_periods"),
        ({"ripple_sigma_nm": 0.1, "ripple_periods": (4.0, 4.0)}, "unique"),
        ({"ripple_sigma_nm": 0.1, "ripple_periods": (0.0,)}, "ripple_periods"),
    ],
)
def test_ripple_that_means_nothing_is_refused(keys: dict[str, Any], word: str) -> None:
    with pytest.raises(ConfigError, match=word):
        with_joints(make_config(), 2, **keys)


def test_without_the_keys_nothing_changes_to_the_bit() -> None:
    problem, other = (
        build_problem(config, robot_model())
        for config in (make_config(doubt=True), with_joints(make_config(doubt=True), 0))
    )
    assert problem.names == other.names
    assert not problem.torque_terms
    assert not [name for name in problem.names if name.startswith(("rotor", "ripple"))]
