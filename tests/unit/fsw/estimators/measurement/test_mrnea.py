"""MRNEA: truth from clean data, covariance, nuisance columns, and the bias the paper's has."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.mrnea import base_acceleration
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from hil.world.truth import Body
from tests.support.estimator_cases import (
    BASE,
    NODES,
    TARGET,
    N,
    draw_biases,
    make_problem,
    motion,
    noisy,
    parameters,
    random_block,
    true_block,
    true_blocks_cached,
    wrong,
)
from tests.support.one_block import mrnea_rows

WEIGHTINGS = ("ols", "wls", "eiv")


def solve(
    blocks: list[Block], problem: Problem, weighting: str, passes: int, *, prior: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return state and covariance of Gauss-Newton from the prior mean, with or without prior."""
    x = problem.prior_mean
    p = len(x)
    inverse = np.linalg.solve(problem.prior_covariance, np.eye(p)) if prior else np.zeros((p, p))
    F = inverse
    for _ in range(passes):
        F, g = inverse, inverse @ (problem.prior_mean - x)
        for block in blocks:
            rows = mrnea_rows(block, x, problem, weighting)
            F, g = F + rows.A.T @ rows.A, g + rows.A.T @ rows.b
        x = x + np.linalg.solve(F, g)
    return x, np.linalg.solve(F, np.eye(p))


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize(
    ("kind", "unknown"),
    [("base", ("base",)), ("target", ("target",)), ("target", ("base", "target"))],
)
def test_clean_data_returns_the_truth(kind: str, unknown: tuple[str, ...], weighting: str) -> None:
    """From 5 % wrong masses; the bound is the truth's integration error, 1e-7, times 3000.

    Without a prior: what the data alone say (undamped steps would diverge from 50 %).
    """
    target = close(TARGET) if "target" in unknown else TARGET
    problem = make_problem(
        unknown,
        base=close(BASE) if "base" in unknown else BASE,
        target=target if kind == "target" else None,
    )
    blocks = list(true_blocks_cached(kind, 59.9)[::3])
    x, _ = solve(blocks, problem, weighting, 1 if weighting == "ols" else 6)
    bodies = {"base": BASE, "target": TARGET}
    for name in unknown:
        true = parameters(bodies[name])
        assert np.abs(x[problem.body(name)] - true).max() < 3e-4 * np.abs(true).max()


def close(body: Body) -> Body:
    return replace(body, mass_kg=1.05 * body.mass_kg)


def test_base_acceleration_is_the_truth_of_another_engine() -> None:
    history = motion("target")
    block = true_block(history, 22.0)
    problem = make_problem()
    w, a = base_acceleration(
        block, np.zeros_like(problem.prior_mean), problem, np.zeros((len(block.t_ns), 3, 3))
    )
    true = history.at(block.t_ns * 1e-9)
    np.testing.assert_allclose(a[:, :3], true.a_NB_B, atol=1e-12)
    np.testing.assert_allclose(a[:, 3:], true.wd_NB_B, atol=1e-12)
    np.testing.assert_allclose(w, true.w_NB_B, atol=1e-12)


@pytest.mark.parametrize("weighting", ["wls", "eiv"])
def test_whitened_residual_at_the_truth_has_unit_covariance(weighting: str) -> None:
    """300 draws of one block: mean square within 4 sigma, every covariance entry within 6.

    The wrench's allowance is not simulated, so it is made negligible.
    """
    problem = make_problem(
        ("target",), biases=False, wrench_force_sigma_n=1e-6, wrench_torque_sigma_nm=1e-6
    )
    block = true_block(motion("target"), 17.3)
    rng = np.random.default_rng(0)
    zero = {key: 0 * value for key, value in draw_biases(rng).items()}
    draws = np.stack(
        [
            mrnea_rows(noisy(block, rng, zero), problem.prior_mean, problem, weighting).b
            for _ in range(300)
        ]
    )
    assert draws.shape[1] == NODES * (N + 6)
    assert abs(np.mean(draws**2) - 1) < 4 * np.sqrt(2 / draws.size)
    assert np.abs(draws.T @ draws / 300 - np.eye(draws.shape[1])).max() < 6 * np.sqrt(2 / 300)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_columns_are_the_derivatives_of_the_residual(weighting: str) -> None:
    """At the truth of clean data the residual vanishes, so A = -db/dx whatever the whitening."""
    problem = make_problem(("base", "target"))
    block = consistent_block(problem)
    x = problem.prior_mean
    rows = mrnea_rows(block, x, problem, weighting)
    assert np.abs(rows.b).max() < 1e-6
    for k in range(len(x)):
        h = 1e-5 * max(1.0, abs(x[k]))
        d = np.zeros_like(x)
        d[k] = h
        up, down = (mrnea_rows(block, x + s * d, problem, weighting).b for s in (1, -1))
        expected = -(up - down) / (2 * h)
        bound = 1e-6 * np.abs(expected).max() + 1e-9 / h
        assert np.abs(rows.A[:, k] - expected).max() <= bound, problem.names[k]


def consistent_block(problem: Problem) -> Block:
    """Return a block of fast arbitrary motion that the problem's prior mean explains exactly."""
    block = random_block()
    p = predict(block, problem.prior_mean, problem)
    return replace(
        block,
        tau_nm=p.tau_nm,
        w_NB_B_rad_s=p.w_rad_s,
        f_NS_B_m_s2=p.f_m_s2,
        wd_NB_B_rad_s2=base_rate_derivative(block, problem),
    )


def base_rate_derivative(block: Block, problem: Problem) -> np.ndarray:
    """Return the predicted wd: what two accelerometers 1 m apart would tell (f is affine in it)."""
    shifted = [
        predict(block, problem.prior_mean, replace(problem, p_BS_m=np.array(r, float))).f_m_s2
        for r in ([0, 0, 0], [1, 0, 0], [0, 1, 0])
    ]
    w = predict(block, problem.prior_mean, problem).w_rad_s
    x, y = (
        shifted[k] - shifted[0] - np.cross(w, np.cross(w, unit))
        for k, unit in ((1, [1.0, 0, 0]), (2, [0, 1.0, 0]))
    )  # wd x e_x = (0, wz, -wy), wd x e_y = (-wz, 0, wx)
    return np.stack([y[:, 2], -x[:, 2], x[:, 1]], axis=1)


@pytest.fixture(scope="module")
def rough() -> list[Block]:
    """The target's motion seen by a base acceleration of 1e-2 m/s^2 and 1e-2 rad/s^2 noise."""
    rng = np.random.default_rng(7)
    zero = {key: 0 * value for key, value in draw_biases(rng).items()}
    blocks = []
    for block in true_blocks_cached("target", 59.9):
        m = NODES
        gyro = np.zeros((2 * m, 2 * m))
        gyro[:m, :m], gyro[m:, m:] = block.cov_gyro[:m, :m], 1e-4 * np.eye(m)
        coarse = replace(block, cov_gyro=gyro, cov_acc=1e-4 * np.eye(m))
        blocks.append(noisy(coarse, rng, zero))
    return blocks


def test_the_papers_regression_shrinks_the_mass_under_noisy_base_acceleration(
    rough: list[Block],
) -> None:
    x, _ = solve(rough, make_problem(("target",), biases=False), "ols", 1)
    assert x[0] < 0.8 * TARGET.mass_kg


def test_errors_in_variables_remove_that_bias(rough: list[Block]) -> None:
    rng = np.random.default_rng(3)
    problem = make_problem(("target",), target=wrong(TARGET, rng), biases=False)
    x, covariance = solve(rough, problem, "eiv", 8, prior=True)
    error = x - parameters(TARGET)
    normalised = error @ np.linalg.solve(covariance, error)
    assert normalised < 29.6  # 99.9 % of chi-square with ten degrees of freedom
    assert abs(error[0]) < 0.01 * TARGET.mass_kg


def test_base_rows_hold_the_base_and_joint_rows_do_not() -> None:
    problem = make_problem(("base",))
    A = mrnea_rows(random_block(), problem.prior_mean, problem, "ols").A
    A = A.reshape(NODES, 6 + N, -1)[:, :, problem.bodies]
    assert not A[:, 6:].any()
    assert A[:, :6].any(axis=(0, 1)).all()
