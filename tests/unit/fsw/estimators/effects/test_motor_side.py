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
from fsw.messages import Block
from tests.support.estimator_cases import NODES, N, make_config, random_block, robot_model
from tests.support.one_block import energy_rows, mrnea_rows

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
    sigma, x = np.sqrt(np.diag(problem.prior_covariance)), problem.prior_mean.copy()
    free = slice(problem.bodies.stop, len(x))
    x[free] += sigma[free] * np.random.default_rng(3).normal(size=len(x[free]))
    x[problem.inertial] = problem.prior_mean[problem.inertial]
    return problem, x


def noisy_angles() -> Block:
    """Return a block that has the covariance of angles, correlated with rates."""
    block, size = random_block(2), 3 * NODES
    root = 1e-3 * np.random.default_rng(5).normal(size=(N, size, size))
    return replace(block, cov_joint=root @ root.transpose(0, 2, 1))


def own_columns(problem: Problem) -> list[int]:
    kinds = ("rotor_inertia", "ripple", "torque_scale", "joint_zero")
    return [k for k, name in enumerate(problem.names) if name.startswith(kinds)]


@pytest.mark.parametrize("everywhere", [True, False])
@pytest.mark.parametrize("rate", ["momentum", "measured"])
def test_predictions_derivatives_by_the_state(rate: Any, everywhere: bool) -> None:
    problem, x = problem_and_state(everywhere=everywhere)
    block, h = noisy_angles(), 1e-6
    J = predict(block, x, problem, rate).J_tau
    own = own_columns(problem)
    assert len(own) >= (N if everywhere else 2) * 5
    for k in own:
        up, down = (predict(block, x + s * np.eye(len(x))[k], problem, rate) for s in (h, -h))
        expected = (up.tau_nm - down.tau_nm) / (2 * h)
        assert np.abs(J[:, :, k] - expected).max() <= 1e-5 * np.abs(expected).max() + 1e-9, k


@pytest.mark.parametrize(
    ("key", "gain"), [("q_rad", "D_q"), ("qd_rad_s", "D_qd"), ("qdd_rad_s2", "D_qdd")]
)
def test_predictions_derivatives_by_the_motion(key: str, gain: str) -> None:
    problem, x = problem_and_state()
    block, h = noisy_angles(), 1e-6
    D = getattr(predict(block, x, problem, "momentum"), gain)[:, :N]
    for j in range(N):
        step = np.zeros((NODES, N))
        step[:, j] = h
        up, down = (
            predict(replace(block, **{key: getattr(block, key) + s * step}), x, problem, "momentum")
            for s in (1.0, -1.0)
        )
        expected = (up.tau_nm - down.tau_nm) / (2 * h)
        assert np.abs(D[:, :, j] - expected).max() <= 1e-5 * np.abs(D).max()


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
    block, h = random_block(4), 1e-6
    own = [k for k in own_columns(problem) if problem.names[k].startswith(("rotor", "ripple"))]
    A = mrnea_rows(block, x, problem, "ols").A
    quiet = replace(block, cov_tau=1e12 * block.cov_tau)
    spans = replace(quiet, t_ns=np.rint(2e8 * (1.0 + gauss_nodes(NODES))).astype(np.int64))
    E = energy_rows(spans, x, problem).A
    for k in own:
        steps = [x + s * np.eye(len(x))[k] for s in (h, -h)]
        b = [mrnea_rows(block, at, problem, "ols").b for at in steps]
        expected = (b[1] - b[0]) / (2 * h)
        assert np.abs(A[:, k] - expected).max() <= 1e-5 * np.abs(expected).max()
        b = [energy_rows(spans, at, problem).b for at in steps]
        expected = (b[1] - b[0]) / (2 * h)
        assert np.abs(E[:, k] - expected).max() <= 1e-4 * np.abs(expected).max()


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
