"""A base that is held: predictions against Pinocchio under gravity, Jacobians, refusals."""

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from fsw.config import Config
from fsw.errors import EstimatorError
from fsw.estimators.batch.run import run_batch
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.row_functions import row_function
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from tests.support.estimator_cases import N, make_config, random_block, robot_model

GRAVITY = (0.0, 0.0, -9.80665)


def held(motion: str, unknown: tuple[str, ...] = ("target",), **base: Any) -> Config:
    data = make_config(unknown).model_dump()
    data["base"] = {"motion": motion, "gravity_B_m_s2": GRAVITY} | base
    return Config.model_validate(data)


def problem_of(config: Config) -> Problem:
    return build_problem(config, robot_model(), exact=True)


@pytest.mark.parametrize("motion", ["clamped", "planar"])
def test_the_prediction_is_inverse_dynamics_under_gravity(motion: str) -> None:
    """The wrench on the base has no part along what is free; the rest is the support's."""
    problem = problem_of(held(motion))
    block = random_block()
    x = problem.prior_mean.copy()
    x[problem.bodies.stop :] = 0.0
    found = predict(block, x, problem)
    own = robot_model().model.copy()
    pi = problem.pi(x)
    for k in range(1, own.njoints):
        own.inertias[k] = pin.Inertia.FromDynamicParameters(pi[10 * (k - 1) : 10 * k])
    own.gravity.linear = np.array(GRAVITY)
    data = own.createData()
    S = problem.freedom
    for i in range(len(block.t_ns)):
        q = np.concatenate([pin.neutral(own)[:7], block.q_rad[i]])
        w = found.w_rad_s[i]
        v = np.concatenate([np.zeros(3), w, block.qd_rad_s[i]])
        acceleration = np.concatenate([np.zeros(6), block.qdd_rad_s2[i]])
        at_rest = pin.rnea(own, data, q, v, acceleration)
        H = pin.crba(own, data, q)
        H = np.triu(H) + np.triu(H, 1).T
        give = -S @ np.linalg.solve(S.T @ H[:6, :6] @ S, S.T @ at_rest[:6])
        acceleration[:6] = give
        wrench = pin.rnea(own, data, q, v, acceleration)
        np.testing.assert_allclose(S.T @ wrench[:6], 0.0, atol=1e-9)
        np.testing.assert_allclose(found.tau_nm[i], wrench[6:], rtol=1e-9, atol=1e-8)
        r = problem.p_BS_m
        force = give[:3] - GRAVITY + np.cross(give[3:], r) + np.cross(w, np.cross(w, r))
        np.testing.assert_allclose(found.f_m_s2[i], force, rtol=1e-9, atol=1e-9)
    if motion == "clamped":
        assert not found.w_rad_s.any()


@pytest.mark.parametrize("motion", ["clamped", "planar"])
def test_jacobians_are_those_of_finite_differences(motion: str) -> None:
    unknown = ("target",) if motion == "clamped" else ("base", "target")
    problem = problem_of(held(motion, unknown))
    block, x = random_block(), problem.prior_mean.copy()
    found = predict(block, x, problem)
    for k in range(len(x)):
        step = 1e-5 * max(1.0, abs(x[k])) * np.eye(len(x))[k]
        up, down = (predict(block, x + sign * step, problem) for sign in (1.0, -1.0))
        for name, J in (("tau_nm", "J_tau"), ("f_m_s2", "J_f"), ("w_rad_s", "J_w")):
            slope = (getattr(up, name) - getattr(down, name)) / (2.0 * step[k])
            np.testing.assert_allclose(getattr(found, J)[:, :, k], slope, rtol=2e-5, atol=2e-6)


def test_the_table_may_stand_at_any_angle_in_the_bases_axes() -> None:
    """Turned with all else, the prediction is the same."""
    normal = np.array([0.6, 0.0, 0.8])
    config = held("planar", normal_B=tuple(normal), gravity_B_m_s2=tuple(-9.8 * normal))
    S = problem_of(config).freedom
    np.testing.assert_allclose(S.T @ S, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(S[:3].T @ normal, 0.0, atol=1e-12)
    np.testing.assert_allclose(np.abs(S[3:].T @ normal), [0.0, 0.0, 1.0], atol=1e-12)


@pytest.mark.parametrize(
    ("motion", "changes", "word"),
    [
        ("free", {"base": {"gravity_B_m_s2": GRAVITY}}, "a free base falls"),
        ("planar", {"base": {"normal_B": (1.0, 0.0, 0.0)}}, "a table is level"),
        ("planar", {"base": {"normal_B": (0.0, 0.0, 2.0)}}, "length 1"),
        ("clamped", {"unknown": ("base",)}, "'base' cannot be found"),
        ("clamped", {"estimator": {"method": "cm"}}, "must be fused or rda"),
        ("planar", {"estimator": {"method": "mrnea"}}, "must be fused or rda or cm"),
        ("clamped", {"estimator": {"momentum_sigma_nms": 1.0}}, "has no momentum"),
    ],
)
def test_what_makes_no_sense_is_refused(motion: str, changes: dict[str, Any], word: str) -> None:
    data = make_config(("base", "target")).model_dump() | {"unknown": ("target",)}
    data["base"] = {"motion": motion}
    if motion != "free":
        data["base"]["gravity_B_m_s2"] = GRAVITY
    for key, value in changes.items():
        data[key] = data[key] | value if isinstance(value, dict) else value
    with pytest.raises(ValueError, match=word):
        Config.model_validate(data)


def test_only_a_clamped_base_does_without_an_inertial_unit() -> None:
    data = held("clamped").model_dump()
    del data["imu"]
    config = Config.model_validate(data)
    assert not config.imu.present
    assert Config.model_validate(config.model_dump()) == config
    assert "imu.port" not in config.missing_ports()
    with pytest.raises(ValueError, match="imu: missing; only a clamped base"):
        Config.model_validate(data | {"base": {"motion": "free"}})


def test_a_batch_that_needs_a_free_base_is_refused_in_words() -> None:
    with pytest.raises(EstimatorError, match=r"needs a free base; base\.motion is clamped"):
        run_batch(held("clamped"), [random_block()], "ce", ())


@pytest.mark.parametrize("method", ["mrnea", "ce"])
def test_a_batch_that_needs_every_torque_is_refused_in_words(method: str) -> None:
    data = make_config(("target",)).model_dump()
    data["joints"][4]["torque"] = "none"
    with pytest.raises(EstimatorError, match=r"'joint5' has torque: none"):
        run_batch(Config.model_validate(data), [random_block()], method, ())


def test_the_start_of_a_batch_uses_no_row_of_the_base() -> None:
    problem = problem_of(held("clamped"))
    rows = row_function("mrnea", "eiv", problem)(random_block(), problem.prior_mean)
    assert rows.A.shape[0] == len(random_block().t_ns) * N


@pytest.mark.parametrize("motion", ["clamped", "planar"])
def test_blocks_without_any_measurement_are_one_line_and_no_fault_of_the_library(
    motion: str,
) -> None:
    """All torque frames were too short, and there is no inertial unit."""
    block = random_block()
    lost = replace(
        block,
        has_joint=np.zeros_like(block.has_joint),
        has_gyro=False,
        has_accelerometer=False,
        has_attitude=False,
    )
    problem = problem_of(held(motion))
    rows = row_function("fused", "eiv", problem)(lost, problem.prior_mean)
    assert rows.A.shape == (0, len(problem.names))
    with pytest.raises(EstimatorError, match="no window has a torque, rate or specific force"):
        run_batch(held(motion), [lost], "fused", ())
