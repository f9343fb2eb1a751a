"""A captured object tumbles: momentum of tens of N m s as state, from the first measured rate."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.config import Config
from fsw.estimators.batch.run import run_batch
from fsw.estimators.measurement import energy
from fsw.estimators.measurement.first_rate import at_first_rate
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.building import build_problem
from fsw.estimators.recursive.online import build_online
from fsw.messages import Block
from hil.world.history import TruthHistory
from hil.world.robot import Robot
from hil.world.truth import simulate
from tests.support.estimator_cases import (
    BASE,
    TARGET,
    URDF,
    WINDOW_S,
    draw_biases,
    make_config,
    noisy,
    parameters,
    random_block,
    robot_model,
    true_block,
    wrong,
)
from tests.support.one_block import energy_rows
from tests.support.slopes import assert_state_slopes
from tests.support.truth_cases import stand_in

RATE_RAD_S = (0.03, -0.02, 0.05)  # 3.5 deg/s
BLOCKS = 60


@cache
def history() -> TruthHistory:
    robot = Robot.load(URDF, "tool", base=BASE, target=TARGET)
    spline = stand_in("target_leo").spline
    return simulate(robot, spline, 0.0, 25.0, 0.005, w_NB_B_rad_s=RATE_RAD_S)


@cache
def true_blocks() -> tuple[Block, ...]:
    return tuple(true_block(history(), k * WINDOW_S, k) for k in range(BLOCKS))


def noisy_blocks(seed: int) -> list[Block]:
    rng = np.random.default_rng(seed)
    biases = draw_biases(rng)
    return [noisy(block, rng, biases) for block in true_blocks()]


def without_attitude(block: Block) -> Block:
    return replace(block, has_attitude=False, R_NB=np.broadcast_to(np.eye(3), block.R_NB.shape))


def config(momentum_sigma_nms: float = 100.0, seed: int = 5, **options: Any) -> Config:
    prior = wrong(TARGET, np.random.default_rng(seed))
    return make_config(("target",), target=prior, momentum_sigma_nms=momentum_sigma_nms, **options)


def true_momentum() -> np.ndarray:
    """The one that the measured rate shows with the true bodies."""
    problem = build_problem(make_config(momentum_sigma_nms=1.0), robot_model())
    x = problem.prior_mean.copy()
    return np.asarray(at_first_rate(true_blocks()[0], x, problem)[problem.at("momentum")])


def error(mean: Any, covariance: Any) -> float:
    e = np.array(mean)[:10] - parameters(TARGET)
    return float(e @ np.linalg.solve(np.array(covariance)[:10, :10], e))


def test_another_engine_s_tumbling_leaves_no_residual() -> None:
    problem = build_problem(make_config(momentum_sigma_nms=1.0), robot_model())
    x = problem.prior_mean.copy()
    x[problem.at("momentum")] = true_momentum()
    assert np.linalg.norm(x[problem.at("momentum")]) > 30.0
    for block in true_blocks()[::7]:
        p = predict(block, x, problem)
        for got, true in (
            (p.tau_nm, block.tau_nm),
            (p.f_m_s2, block.f_NS_B_m_s2),
            (p.w_rad_s, block.w_NB_B_rad_s),
        ):
            assert np.abs(got - true).max() <= 1e-6 * np.abs(true).max()


@pytest.mark.parametrize("rate", ["momentum", "measured"])
@pytest.mark.parametrize("seed", [1, 2])
def test_state_jacobians_at_much_momentum_are_the_derivatives(seed: int, rate: Any) -> None:
    problem = build_problem(
        make_config(("base", "target"), momentum_sigma_nms=100.0), robot_model()
    )
    x = problem.prior_mean.copy()
    x[20:] = 0.1 * np.random.default_rng(seed).normal(size=len(x) - 20)
    x[problem.at("momentum")] = [60.0, -40.0, 150.0]
    block = random_block(seed)
    assert_state_slopes(
        lambda x: predict(block, x, problem, rate),
        x,
        lambda k: 1e-4 * max(1.0, abs(x[k])),
        rtol=0.0,
        of_slope=1e-6,
        rounding=1e-13,
    )


def test_energy_rows_at_much_momentum_are_the_derivatives(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(energy, "whitened", lambda _, J, b: (J, b))
    problem = build_problem(
        make_config(("base", "target"), momentum_sigma_nms=100.0), robot_model()
    )
    x = problem.prior_mean.copy()
    x[problem.at("momentum")] = [60.0, -40.0, 150.0]
    block = random_block(1)
    block = replace(block, cov_joint=1e-12 * block.cov_joint)  # its share is no part of J
    found = energy_rows(block, x, problem)
    for k in range(len(x)):
        h = 1e-5 * max(1.0, abs(x[k]))
        d = h * np.eye(len(x))[k]
        up, down = (energy_rows(block, x + sign * d, problem).b for sign in (1.0, -1.0))
        slope = (down - up) / (2.0 * h)
        rounding = 1e-13 * np.abs(found.b).max() / h
        assert np.abs(found.A[:, k] - slope).max() <= 1e-5 * np.abs(slope).max() + rounding
    assert np.abs(found.A[:, problem.at("momentum")]).max() > 0


@pytest.mark.parametrize("method", ["fused", "rda", "mrnea", "ce"])
def test_noise_free_blocks_give_the_target_back(method: str) -> None:
    found = run_batch(config(biases=False), true_blocks(), method, ("target",))
    target = found["estimate"]["target"]
    assert target["mass_kg"] == pytest.approx(TARGET.mass_kg, rel=1e-3)
    np.testing.assert_allclose(target["com_m"], TARGET.com_m, atol=1e-3)
    if method == "fused":
        momentum = [
            m for n, m in zip(found["names"], found["mean"], strict=True) if "momentum" in n
        ]
        np.testing.assert_allclose(momentum, true_momentum(), atol=0.01)


def test_the_first_rate_is_predicted_at_the_point_it_gives() -> None:
    problem = build_problem(config(), robot_model())
    block = noisy_blocks(1)[0]
    x = at_first_rate(block, problem.prior_mean, problem)
    p = predict(block, x, problem)
    np.testing.assert_allclose(p.w_rad_s.mean(axis=0), block.w_NB_B_rad_s.mean(axis=0), atol=1e-4)
    others = np.delete(np.arange(len(x)), np.r_[problem.at("momentum")])
    np.testing.assert_array_equal(x[others], problem.prior_mean[others])
    unknown = without_attitude(block)
    np.testing.assert_array_equal(at_first_rate(unknown, x, problem), x)


@pytest.mark.parametrize("sigma_nms", [5.0, 100.0, 1e4])
def test_the_recursion_is_right_from_the_first_windows_on(sigma_nms: float) -> None:
    """Momentum of 61 N m s; the prior may be much too tight or as wide as wanted."""
    online = build_online(config(sigma_nms), robot_model())
    for block in noisy_blocks(1):
        estimate = online.push(block)
        if estimate.valid:
            assert error(estimate.mean, estimate.covariance) < chi2.ppf(1 - 1e-6, 10)
    final = online.finish()
    assert final.valid, final.reason
    assert error(final.mean, final.covariance) < chi2.ppf(0.999, 10)


def test_without_attitude_the_measured_rate_serves() -> None:
    blocks = [without_attitude(block) for block in noisy_blocks(2)]
    online = build_online(config(), robot_model())
    for block in blocks:
        online.push(block)
    final = online.finish()
    assert final.valid, final.reason
    assert error(final.mean, final.covariance) < chi2.ppf(0.999, 10)


def test_momentum_that_is_not_declared_is_never_confidently_wrong() -> None:
    online = build_online(config(0.0), robot_model())
    for block in noisy_blocks(3):
        assert not online.push(block).valid
    assert not online.finish().valid
    found = run_batch(config(0.0), noisy_blocks(3), "fused", ("target",))
    assert found["status"] != "OK"
