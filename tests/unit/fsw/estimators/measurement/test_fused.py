"""The fused prediction: derivatives, the truth of another engine, RDA's equality, whitening."""

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.prediction import CHANNELS
from fsw.estimators.model.inertia import from_parameters
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from tests.support.estimator_cases import (
    NODES,
    TARGET,
    N,
    draw_biases,
    make_problem,
    motion,
    noisy,
    random_block,
    true_block,
)
from tests.support.one_block import fused_rows
from tests.support.slopes import assert_state_slopes

RATES = ("momentum", "measured")


def problem_and_state(seed: int = 1, **options: Any) -> tuple[Problem, np.ndarray]:
    problem = make_problem(**{"unknown": ("base", "target"), "momentum_sigma_nms": 1.0} | options)
    x = problem.prior_mean.copy()
    x[20:] = 0.1 * np.random.default_rng(seed).normal(size=len(x) - 20)
    return problem, x


def outputs(block: Block, x: np.ndarray, problem: Problem, rate: Any) -> np.ndarray:
    p = predict(block, x, problem, rate)
    return np.concatenate([p.tau_nm, p.f_m_s2, p.w_rad_s], axis=1)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("seed", [1, 2])
def test_state_jacobians_are_the_derivatives(seed: int, rate: Any) -> None:
    problem, x = problem_and_state(seed)
    block = random_block(seed)
    assert_state_slopes(
        lambda x: predict(block, x, problem, rate),
        x,
        lambda k: 1e-4 * max(1.0, abs(x[k])),
        rtol=0.0,
        of_slope=1e-6,
        rounding=1e-13,
    )


@pytest.mark.parametrize(
    ("field", "gain", "rows", "rate"),
    [
        ("qdd_rad_s2", "D_qdd", N + 3, "momentum"),
        ("qdd_rad_s2", "D_qdd", N + 3, "measured"),
        ("qd_rad_s", "D_qd", N + 6, "momentum"),
        ("qd_rad_s", "D_qd", N + 3, "measured"),
        ("w_NB_B_rad_s", "D_w", N + 3, "measured"),
    ],
)
def test_input_gains_are_the_derivatives(field: str, gain: str, rows: int, rate: Any) -> None:
    problem, x = problem_and_state()
    block = random_block()
    D = getattr(predict(block, x, problem, rate), gain)
    for j in range(D.shape[2]):
        d = np.zeros_like(getattr(block, field))
        d[:, j] = 1e-5
        up, down = (
            outputs(replace(block, **{field: getattr(block, field) + s * d}), x, problem, rate)
            for s in (1, -1)
        )
        expected = (up - down)[:, :rows] / 2e-5
        got = D[:, :rows, j]
        np.testing.assert_allclose(got, expected, atol=1e-6 * max(np.abs(D).max(), 1e-2))


@pytest.mark.parametrize(
    ("kind", "unknown"),
    [("base", ("base",)), ("target", ("target",)), ("target", ("base", "target"))],
)
def test_prediction_at_the_true_parameters_is_the_other_engines_truth(
    kind: str, unknown: tuple[str, ...]
) -> None:
    problem = make_problem(unknown, target=TARGET if kind == "target" else None)
    history = motion(kind)
    for start in (3.0, 17.3, 41.2, 55.0):
        block = true_block(history, start)
        for rate in RATES:
            p = predict(block, problem.prior_mean, problem, rate)
            for got, true in (
                (p.tau_nm, block.tau_nm),
                (p.f_m_s2, block.f_NS_B_m_s2),
                (p.w_rad_s, block.w_NB_B_rad_s),
            ):
                assert np.abs(got - true).max() <= 1e-6 * np.abs(true).max()


def test_torque_prediction_does_not_depend_on_the_base_velocity() -> None:
    """RNEA with a moving base and the spatial acceleration of that motion: the same torque."""
    problem, x = problem_and_state()
    x[20:] = 0.0
    block = random_block()
    tau = predict(block, x, problem).tau_nm
    model = problem.model.model.copy()
    pi = problem.pi(x)
    for k in range(1, model.njoints):
        model.inertias[k] = pin.Inertia.FromDynamicParameters(pi[10 * (k - 1) : 10 * k])
    data = model.createData()
    rng = np.random.default_rng(0)
    for i in range(NODES):
        q = np.concatenate([pin.neutral(model)[:7], block.q_rad[i]])
        H = pin.crba(model, data, q)
        H = np.triu(H) + np.triu(H, 1).T
        w = -np.linalg.solve(H[:6, :6], H[:6, 6:] @ block.qd_rad_s[i])[3:]
        for v_b in (np.zeros(3), rng.normal(size=3)):
            v = np.concatenate([v_b, w, block.qd_rad_s[i]])
            a = np.concatenate([np.zeros(6), block.qdd_rad_s2[i]])
            a[:6] = -np.linalg.solve(H[:6, :6], pin.rnea(model, data, q, v, a)[:6])
            force = pin.rnea(model, data, q, v, a)
            np.testing.assert_allclose(force[:6], 0.0, atol=1e-9)
            np.testing.assert_allclose(force[6:], tau[i], rtol=1e-9, atol=1e-9)
            # and the classical acceleration is what the accelerometer model uses
            classical = a[:3] + np.cross(w, v_b)
            f = predict(block, x, problem).f_m_s2[i]
            r = problem.p_BS_m
            lever = np.cross(a[3:6], r) + np.cross(w, np.cross(w, r))
            np.testing.assert_allclose(classical + lever, f, atol=1e-9)


def test_residual_momentum_turns_the_whole_at_rest() -> None:
    """Arm locked: composite inertia about the common centre of mass, constant L in N."""
    problem, x = problem_and_state()
    x[20:] = 0.0
    L = np.array([0.4, -1.0, 0.7])
    x[problem.at("momentum")] = L
    block = random_block()
    still = replace(
        block, qd_rad_s=np.zeros_like(block.qd_rad_s), qdd_rad_s2=np.zeros_like(block.qdd_rad_s2)
    )
    w = predict(still, x, problem).w_rad_s
    for i in range(NODES):
        _, _, six = from_parameters(problem.model.composite(still.q_rad[i]) @ problem.pi(x))
        central = six[np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])]
        np.testing.assert_allclose(central @ w[i], still.R_NB[i].T @ L, rtol=1e-9, atol=1e-12)


def test_whitened_residual_at_the_truth_has_unit_covariance() -> None:
    """300 draws of one block: mean square within 4 sigma, every covariance entry within 6."""
    problem = make_problem(("target",), biases=False)
    block = true_block(motion("target"), 17.3)
    rng = np.random.default_rng(0)
    zero = {key: 0 * value for key, value in draw_biases(rng).items()}
    torque = ("torque", "accelerometer")  # a measured rate leaves the gyro nothing to say
    for rate, channels, count in (("momentum", CHANNELS, N + 6), ("measured", torque, N + 3)):
        draws = np.stack(
            [
                fused_rows(noisy(block, rng, zero), problem.prior_mean, problem, channels, rate).b
                for _ in range(300)
            ]
        )
        assert draws.shape[1] == NODES * count
        assert abs(np.mean(draws**2) - 1) < 4 * np.sqrt(2 / draws.size)
        assert np.abs(draws.T @ draws / 300 - np.eye(draws.shape[1])).max() < 6 * np.sqrt(2 / 300)


@pytest.mark.parametrize(
    ("channels", "changes", "count"),
    [
        (("torque",), {}, N),
        (("gyro",), {}, 3),
        (("torque", "accelerometer", "gyro"), {"has_gyro": False}, N + 3),
        (("torque", "accelerometer", "gyro"), {"has_accelerometer": False}, N + 3),
        (("torque", "accelerometer"), {"has_joint": np.arange(N) != 2}, N + 2),
    ],
)
def test_rows_are_those_of_the_channels_chosen_and_present(
    channels: tuple[str, ...], changes: dict[str, Any], count: int
) -> None:
    problem, x = problem_and_state()
    rows = fused_rows(replace(random_block(), **changes), x, problem, channels)
    assert rows.A.shape == (NODES * count, len(x))
    assert rows.b.shape == (NODES * count,)


def test_absent_channels_do_not_matter() -> None:
    problem, x = problem_and_state()
    block = random_block()
    absent = replace(block, has_gyro=False, has_joint=np.arange(N) != 4)
    tau = block.tau_nm.copy()
    tau[:, 4] = 1e6
    junk = replace(absent, tau_nm=tau, w_NB_B_rad_s=np.full((NODES, 3), 1e6))
    a, b = fused_rows(absent, x, problem), fused_rows(junk, x, problem)
    assert np.array_equal(a.A, b.A)
    assert np.array_equal(a.b, b.b)
