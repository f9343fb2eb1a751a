"""Blocks whose angles are as noisy as their rates: derivatives, covariance, smoothed Jacobian."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.estimators.conditioning.polynomial import NodeFit, gauss_nodes
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray
from tests.support.estimator_cases import (
    BASE,
    NODES,
    RATE_HZ,
    TARGET,
    N,
    make_problem,
    motion,
    parameters,
    random_block,
)
from tests.support.one_block import fused_rows

ANGLE_RAD, TORQUE_NM, RATE_RAD_S, ACC_M_S2 = 3e-3, 3e-3, 3e-3, 3e-3
LONG_S, LONG_NODES = 3.0, 6  # window: rates of such angles want one
WINDOWS = 19


def truth(problem: Problem) -> FloatArray:
    x = np.zeros(len(problem.names))
    for name in problem.unknown:
        x[problem.body(name)] = parameters({"base": BASE, "target": TARGET}[name])
    return x


def with_angles(block: Block) -> Block:
    return replace(block, cov_joint=np.stack([1e-6 * np.eye(3 * NODES)] * N))


@pytest.mark.parametrize("rate", ["momentum", "measured"])
def test_gain_by_angles_agrees_with_finite_differences(rate):
    problem = replace(make_problem(("base", "target"), biases=False), angles_are_noisy=True)
    x, block = truth(problem), with_angles(random_block())
    one = predict(block, x, problem, rate)
    assert predict(random_block(), x, problem, rate).D_q is None
    h, names = 1e-5, ("tau_nm", "f_m_s2", "w_rad_s")
    for j in range(N):
        up, down = (
            predict(replace(block, q_rad=block.q_rad + s * np.eye(N)[j]), x, problem, rate)
            for s in (h, -h)
        )
        parts = [getattr(up, name) - getattr(down, name) for name in names]
        numeric = np.concatenate(parts, axis=1) / (2 * h)
        if rate == "measured":
            numeric[:, N + 3 :] = 0.0
        assert np.allclose(one.D_q[:, :, j], numeric, atol=1e-5 * np.abs(one.D_q).max())


def measured_block(index: int, rng: np.random.Generator) -> Block:
    """A window of 3 s of the true motion under noise on every channel, no biases."""
    half = LONG_S / 2
    t = np.arange(-half, half - 1e-9, 1 / RATE_HZ) + 0.5 / RATE_HZ
    low, high = (
        NodeFit(t, half, LONG_NODES - 1, LONG_NODES),
        NodeFit(t, half, LONG_NODES + 2, LONG_NODES),
    )
    centre, history = (index + 0.5) * LONG_S, motion("target")
    s = history.at(centre + t)
    at = centre + half * gauss_nodes(LONG_NODES)

    def smoothed(fit: NodeFit, values: np.ndarray, sigma: float, order: int = 0) -> np.ndarray:
        noise = sigma * rng.standard_normal(values.shape)
        return fit.operator(order) @ fit.coefficients(values + noise)

    angles = high.coefficients(s.q + ANGLE_RAD * rng.standard_normal(s.q.shape))
    q, qd, qdd = (high.operator(k) @ angles for k in range(3))
    return Block(
        index=index,
        t_ns=np.rint(at * 1e9).astype(np.int64),
        q_rad=q,
        qd_rad_s=qd,
        qdd_rad_s2=qdd,
        tau_nm=smoothed(low, s.tau, TORQUE_NM),
        w_NB_B_rad_s=smoothed(low, s.w_NB_B, RATE_RAD_S),
        wd_NB_B_rad_s2=smoothed(low, s.w_NB_B, RATE_RAD_S, 1),
        f_NS_B_m_s2=smoothed(low, s.a_NB_B, ACC_M_S2),
        R_NB=history.at(at).R_NB,
        cov_joint=np.stack([high.covariance((1, 2, 0), ANGLE_RAD)] * N),
        cov_tau=np.stack([low.covariance((0,), TORQUE_NM)] * N),
        cov_gyro=low.covariance((0, 1), RATE_RAD_S),
        cov_acc=low.covariance((0,), ACC_M_S2),
        has_joint=np.ones(N, dtype=bool),
        has_gyro=True,
        has_accelerometer=True,
        has_attitude=True,
    )


def noisy_problem() -> Problem:
    return replace(
        make_problem(("target",), biases=False),
        p_BS_m=np.zeros(3),
        window_s=LONG_S,
        angles_are_noisy=True,
    )


def test_residuals_are_as_large_as_their_covariance_says():
    """Whitened at the truth over 19 windows; with the angles taken as exact they are too large."""
    problem = noisy_problem()
    x, rng = truth(problem), np.random.default_rng(5)
    told, untold, dof = 0.0, 0.0, 0
    for k in range(WINDOWS):
        block = measured_block(k, rng)
        b = fused_rows(block, x, problem).b
        exact = replace(block, cov_joint=block.cov_joint[:, : 2 * LONG_NODES, : 2 * LONG_NODES])
        bare = fused_rows(exact, x, problem).b
        told, untold, dof = told + b @ b, untold + bare @ bare, dof + len(b)
    assert told < chi2.ppf(1 - 1e-3, dof)
    assert untold > chi2.ppf(1 - 1e-3, dof)


def test_the_smoothed_jacobian_is_not_correlated_with_the_residuals():
    """The score at the truth has mean zero: |sum A^T b| within its own covariance."""
    problem = noisy_problem()
    x, rng = truth(problem), np.random.default_rng(6)
    score, G = np.zeros(len(x)), np.zeros((len(x), len(x)))
    for k in range(WINDOWS):
        rows = fused_rows(measured_block(k, rng), x, problem)
        score, G = score + rows.A.T @ rows.b, G + rows.A.T @ rows.A
    assert score @ np.linalg.solve(G, score) < chi2.ppf(1 - 1e-3, len(x))
