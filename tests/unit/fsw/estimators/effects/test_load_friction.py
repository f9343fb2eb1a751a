"""Friction over the load: derivatives in both methods of a held arm, sign, configuration."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fsw.config import Config
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from tests.support.estimator_cases import NODES, N, make_config, random_block, robot_model

HELD = {"motion": "clamped", "gravity_B_m_s2": [0.0, 0.0, -9.81]}
KEYS = {
    "torque": "motor_current",
    "friction_coulomb_sigma_nm": 3.0,
    "friction_load_sigma_ratio": 0.2,
    "rotor_inertia_sigma_kg_m2": 0.4,
    "torque_scale_sigma_ratio": 0.1,
    "friction_speed_rad_s": 0.05,
}


def loaded(**keys: Any) -> Config:
    config = make_config(doubt=True)
    data = [joint.model_dump() | KEYS | keys for joint in config.joints]
    return config.with_sections(joints=data, base=HELD)


def problem_and_state() -> tuple[Problem, np.ndarray]:
    problem = replace(build_problem(loaded(), robot_model()), angles_are_noisy=True)
    sigma, x = np.sqrt(np.diag(problem.prior_covariance)), problem.prior_mean.copy()
    free = slice(problem.bodies.stop, len(x))
    x[free] += sigma[free] * np.random.default_rng(3).normal(size=len(x[free]))
    return problem, x


def noisy_angles() -> Block:
    """Return a block that has the covariance of angles, correlated with rates."""
    block, size = random_block(2), 3 * NODES
    root = 1e-3 * np.random.default_rng(5).normal(size=(N, size, size))
    return replace(block, cov_joint=root @ root.transpose(0, 2, 1))


@pytest.mark.parametrize("rate", ["momentum", "measured"])
def test_derivatives_by_the_state(rate: Any) -> None:
    problem, x = problem_and_state()
    block, h = noisy_angles(), 1e-6
    at = predict(block, x, problem, rate)
    J, rounding = at.J_tau, 1e-15 * np.abs(at.tau_nm).max() / h
    assert sum(name.startswith("friction_load.") for name in problem.names) == N
    for k in range(len(x)):
        up, down = (predict(block, x + s * np.eye(len(x))[k], problem, rate) for s in (h, -h))
        expected = (up.tau_nm - down.tau_nm) / (2 * h)
        off = np.abs(J[:, :, k] - expected).max()
        assert off <= 1e-5 * np.abs(expected).max() + 2.0 * rounding, problem.names[k]


@pytest.mark.parametrize(("key", "gain"), [("q_rad", "D_q"), ("qdd_rad_s2", "D_qdd")])
def test_derivatives_by_the_motion(key: str, gain: str) -> None:
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


def test_a_gear_takes_its_share_both_ways() -> None:
    """The motor gives more where it lifts a weight, and less where it lets the weight down."""
    problem = build_problem(loaded(), robot_model())
    up, x = random_block(2), problem.prior_mean.copy()
    fast = np.full_like(up.qd_rad_s, 0.3)
    x[problem.at("friction_load")] = 0.1
    for sign in (1.0, -1.0):
        block = replace(up, qd_rad_s=sign * fast, qdd_rad_s2=np.zeros_like(fast))
        rigid = predict(block, problem.prior_mean, problem, "momentum").tau_nm
        share = predict(block, x, problem, "momentum").tau_nm / rigid
        # beyond the friction's speed tanh is 1 within 2 exp(-12)
        np.testing.assert_allclose(share, 1.0 + 0.1 * np.sign(sign * rigid), atol=1e-4)


def test_it_is_on_for_motor_current_of_a_held_arm_alone() -> None:
    data = make_config().joints[0].model_dump(exclude_unset=True) | {"torque": "motor_current"}
    joint = make_config().with_sections(
        joints=[data, *[j.model_dump() for j in make_config().joints[1:]]]
    )
    assert joint.joints[0].friction_load_sigma_ratio == pytest.approx(0.1)
    free = build_problem(joint, robot_model())
    assert not [name for name in free.names if name.startswith("friction_load")]
    link_side = build_problem(make_config().with_sections(base=HELD), robot_model())
    assert not [name for name in link_side.names if name.startswith("friction_load")]
