"""Friction over the load: derivatives in both methods of a held arm, sign, configuration."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fsw.config import Config
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from tests.support.estimator_cases import N, make_config, noisy_angles, random_block, robot_model
from tests.support.slopes import (
    TORQUE,
    assert_motion_slopes,
    assert_state_slopes,
    named,
    off_the_prior,
)

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
    return problem, off_the_prior(problem)


@pytest.mark.parametrize("rate", ["momentum", "measured"])
def test_derivatives_by_the_state(rate: Any) -> None:
    problem, x = problem_and_state()
    block = noisy_angles()
    assert len(named(problem, "friction_load.")) == N
    assert_state_slopes(
        lambda x: predict(block, x, problem, rate),
        *(x, 1e-6),
        rtol=0.0,
        of_slope=1e-5,
        rounding=2e-15,
        fields=TORQUE,
    )


@pytest.mark.parametrize(("key", "gain"), [("q_rad", "D_q"), ("qdd_rad_s2", "D_qdd")])
def test_derivatives_by_the_motion(key: str, gain: str) -> None:
    problem, x = problem_and_state()
    assert_motion_slopes(lambda block: predict(block, x, problem), noisy_angles(), key, gain)


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
