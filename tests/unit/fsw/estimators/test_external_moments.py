"""Gravity gradient and constant wrench against the other engine, applied there body by body."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.config import OrbitConfig
from fsw.config.constants import EARTH_GRAVITY_PARAMETER_M3_S2
from fsw.estimators.batch.solver import solve
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.row_functions import row_function
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.orbit import CircularOrbit
from fsw.estimators.model.problem import Problem
from fsw.estimators.recursive.online import OnlineEstimator
from fsw.messages import Block, FloatArray
from hil.world.history import TruthHistory
from hil.world.spline import JointSpline
from hil.world.truth import Robot, simulate
from tests.support.estimator_cases import (
    BASE,
    HIL,
    MOTION,
    TARGET,
    URDF,
    WINDOW_S,
    draw_biases,
    make_config,
    make_problem,
    noisy,
    parameters,
    random_block,
    robot_model,
    true_block,
)
from tests.support.one_block import mrnea_rows

RADIUS_M = 6_878_137.0
RATE = (EARTH_GRAVITY_PARAMETER_M3_S2 / RADIUS_M**3) ** 0.5
UP, ALONG = np.array([0.6, 0.0, 0.8]), np.array([-0.8, 0.0, 0.6])
START_S, STOP_S = -3.0, 57.0


def orbit() -> CircularOrbit:
    speed = RATE * RADIUS_M
    return CircularOrbit.from_config(
        OrbitConfig(position_m=tuple(RADIUS_M * UP), velocity_m_s=tuple(speed * ALONG), epoch_ns=0)
    )


def gravity_gradient(model: Any) -> Any:
    """Force and torque per body about its own centre of mass, from the point-mass expansion."""

    mass, inertia = model.body_mass[1:, None], model.body_inertia[1:]

    def wrench(t_s: float, data: Any) -> None:
        up = np.cos(RATE * t_s) * UP + np.sin(RATE * t_s) * ALONG
        R = data.ximat[1:].reshape(-1, 3, 3)
        d = data.xipos[1:] - np.sum(mass * data.xipos[1:], axis=0) / mass.sum()
        turned = np.einsum("bij,bj->bi", R, inertia * (up @ R))
        data.xfrc_applied[1:, :3] = mass * RATE**2 * (3 * np.outer(d @ up, up) - d)
        data.xfrc_applied[1:, 3:] = 3 * RATE**2 * np.cross(up, turned)

    return wrench


FORCE_N, MOMENT_NM = np.array([0.02, -0.01, 0.03]), np.array([0.004, 0.006, -0.005])


def constant_wrench(model: Any) -> Any:
    """A constant inertial force and moment at the base body's origin."""

    def wrench(_t_s: float, data: Any) -> None:
        base = int(model.jnt_bodyid[0])
        lever = data.xpos[base] - data.xipos[base]
        data.xfrc_applied[base, :3] = FORCE_N
        data.xfrc_applied[base, 3:] = MOMENT_NM + np.cross(lever, FORCE_N)

    return wrench


@lru_cache(maxsize=3)
def disturbed(kind: str) -> TruthHistory:
    spline = JointSpline.load(HIL / "trajectories" / f"{MOTION['target']}.yaml")
    robot = Robot.load(URDF, "tool", base=BASE, target=TARGET)
    kinds = {"gradient": gravity_gradient, "wrench": constant_wrench, "target": pushed_target}
    force = kinds[kind]
    return simulate(
        robot, spline, START_S, spline.duration_s + 1.0, dt_s=0.01, wrench=force(robot.model)
    )


def blocks(history: TruthHistory) -> list[Block]:
    count = round((STOP_S - START_S) / WINDOW_S)
    return [true_block(history, START_S + k * WINDOW_S, k) for k in range(count)]


def errors(problem: Problem, x: FloatArray, history: TruthHistory) -> tuple[float, float]:
    """Return the largest errors of the predicted rate and torque, the impulse carried along."""
    rate, torque = 0.0, 0.0
    before: Impulse | None = None
    for block in blocks(history):
        p = predict(block, x, problem, before=before)
        before = p.after
        rate = max(rate, float(np.abs(p.w_rad_s - block.w_NB_B_rad_s).max()))
        torque = max(torque, float(np.abs(p.tau_nm - block.tau_nm).max()))
    return rate, torque


def test_gravity_gradient_explains_rate_and_torque_of_the_truth() -> None:
    """Modelled, at most 1 % of its effect is left on the rate and on the joint torques."""
    plain = make_problem(("base", "target"))
    history = disturbed("gradient")
    ignored = errors(plain, plain.prior_mean, history)
    left = errors(replace(plain, orbit=orbit()), plain.prior_mean, history)
    assert ignored[0] > 2e-5  # rad/s: the effect is there
    assert ignored[1] > 1e-4  # N m
    assert left[0] <= 0.01 * ignored[0]
    assert left[1] <= 0.01 * ignored[1]


def pushed_target(model: Any) -> Any:
    """A constant inertial force at the target's centre of mass, and a moment."""

    def wrench(_t_s: float, data: Any) -> None:
        body = model.nbody - 1
        assert model.body(body).name == "grasped target"
        data.xfrc_applied[body] = [*FORCE_N, *MOMENT_NM]

    return wrench


def test_a_push_on_the_target_loads_the_joints_as_the_model_says() -> None:
    """Estimated on the target, at most 1 % of the effect is left; a wrench on the base is wrong."""
    history = disturbed("target")
    plain = make_problem(("base", "target"))
    ignored = errors(plain, plain.prior_mean, history)
    sigmas = {f"target_{k}": 0.1 for k in ("force_sigma_n", "torque_sigma_nm")}
    problem = make_problem(("base", "target"), **sigmas)
    x = problem.prior_mean.copy()
    x[problem.at("target_wrench")] = np.concatenate([FORCE_N, MOMENT_NM, np.zeros(3)])
    left = errors(problem, x, history)
    assert ignored[0] > 1e-5
    assert ignored[1] > 1e-3
    assert left[0] <= 0.01 * ignored[0]
    assert left[1] <= 0.01 * ignored[1]


def test_the_target_wrenchs_jacobian_is_the_difference_it_makes() -> None:
    sigmas = {f"target_{k}": 0.1 for k in ("force_sigma_n", "torque_sigma_nm")}
    problem = make_problem(("base",), **sigmas)
    block, x = random_block(), problem.prior_mean
    one = predict(block, x, problem)
    for column in range(problem.at("target_wrench").start, problem.at("target_wrench").stop):
        step = np.zeros(len(x))
        step[column] = 1e-3
        two, back = predict(block, x + step, problem), predict(block, x - step, problem)
        for name, J in (("tau_nm", "J_tau"), ("f_m_s2", "J_f"), ("w_rad_s", "J_w")):
            numeric = (getattr(two, name) - getattr(back, name)) / 2e-3
            found = getattr(one, J)[:, :, column]
            assert np.allclose(found, numeric, atol=1e-6 * max(1.0, np.abs(found).max()))


def test_constant_wrench_explains_rate_and_torque_of_the_truth() -> None:
    plain = make_problem(("base", "target"))
    history = disturbed("wrench")
    ignored = errors(plain, plain.prior_mean, history)
    wrench = make_problem(
        ("base", "target"), external_force_sigma_n=0.1, external_torque_sigma_nm=0.1
    )
    x = wrench.prior_mean.copy()
    x[wrench.at("wrench")] = np.concatenate([FORCE_N, MOMENT_NM])
    left = errors(wrench, x, history)
    assert ignored[0] > 1e-4
    assert left[0] <= 0.01 * ignored[0]
    assert left[1] <= 0.01 * ignored[1]


def test_mrnea_with_the_gradient_has_no_residual_in_the_truth() -> None:
    """Noise-free rows, the accelerometer in the field at its own place: a hundredth is left."""
    plain = make_problem(("base", "target"))
    history = disturbed("gradient")
    block = true_block(history, 30.0)
    G = orbit().field(block, WINDOW_S)
    whole = [plain.model.composite(q) @ plain.pi(plain.prior_mean) for q in block.q_rad]
    place = plain.p_BS_m - np.array([pi[1:4] / pi[0] for pi in whole])
    felt = block.f_NS_B_m_s2 - np.einsum("mij,mj->mi", G, place)
    block = replace(block, f_NS_B_m_s2=felt)
    ignored = mrnea_rows(block, plain.prior_mean, plain, "ols").b
    modelled = mrnea_rows(block, plain.prior_mean, replace(plain, orbit=orbit()), "ols").b
    joints = np.arange(ignored.size) % 13 >= 6
    assert np.abs(modelled[joints]).max() <= 0.01 * np.abs(ignored[joints]).max()


@pytest.mark.parametrize("rate", ["momentum", "measured"])
def test_jacobians_with_every_nuisance_match_finite_differences(rate: Any) -> None:
    """At 1e5 times Earth's gradient, so that its part is seen."""
    problem = make_problem(
        ("base", "target"),
        momentum_sigma_nms=1.0,
        external_force_sigma_n=0.1,
        external_torque_sigma_nm=0.1,
    )
    problem = replace(problem, orbit=replace(orbit(), gradient_1_s2=1e5 * RATE**2))
    rng = np.random.default_rng(3)
    x = problem.prior_mean.copy()
    x[20:] = 0.1 * rng.normal(size=len(x) - 20)
    block = random_block()
    before = Impulse(0, np.array([0.3, -0.2, 0.5]), np.zeros((3, len(x))), x)
    p = predict(block, x, problem, rate, before)
    for name, J in (("tau_nm", p.J_tau), ("f_m_s2", p.J_f), ("w_rad_s", p.J_w)):
        for k in range(len(x)):
            d = np.zeros_like(x)
            d[k] = 1e-5 * max(1.0, abs(x[k]))
            up = getattr(predict(block, x + d, problem, rate, before), name)
            down = getattr(predict(block, x - d, problem, rate, before), name)
            expected = (up - down) / (2 * d[k])
            scale = max(float(np.abs(J[:, :, k]).max()), 1e-6)
            np.testing.assert_allclose(J[:, :, k], expected, atol=2e-6 * scale + 1e-9)


def test_the_recursion_carries_the_impulse_as_the_batch_does() -> None:
    """Base and target unknown under the gradient, noise on, store of 40 of 150 blocks."""
    rng = np.random.default_rng(5)
    biases = draw_biases(rng)
    noisy_run = [noisy(block, rng, biases) for block in blocks(disturbed("gradient"))]
    config = make_config(("base", "target"), store_blocks=40)
    problem = replace(build_problem(config, robot_model()), orbit=orbit())
    rows = row_function("fused", "eiv", problem)
    online = OnlineEstimator(problem, config.estimator, rows, linear=False)
    for block in noisy_run:
        estimate = online.push(block)
    batch = solve(problem, rows, noisy_run)
    assert batch.status == "OK"
    difference = batch.information.R @ (estimate.mean - batch.mean)
    assert np.sqrt(np.mean(difference**2)) <= 0.2
    truth = np.concatenate([parameters(BASE), parameters(TARGET)])
    error, P = estimate.mean[:20] - truth, estimate.covariance[:20, :20]
    assert error @ np.linalg.solve(P, error) <= chi2.ppf(0.999, 20)
