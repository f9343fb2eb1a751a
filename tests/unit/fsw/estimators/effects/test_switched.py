"""Thrusters in the measurement models: projections against quadrature, Jacobians, momentum."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import legendre
from scipy.integrate import quad

from fsw.errors import EstimatorError
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.impulse import momentum_at_nodes
from fsw.estimators.measurement.row_functions import row_function
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from tests.support.estimator_cases import NODES, WINDOW_S, random_block, robot_model
from tests.support.one_block import mrnea_rows
from tests.support.slopes import assert_state_slopes, predicted_fields
from tests.support.thruster_cases import CORNERS, config_with_thrusters, edges_of, firing

ACROSS = {"rtol": 2e-5}


def case(seed: int = 1, **options: Any) -> tuple[Problem, np.ndarray, Block]:
    problem = build_problem(config_with_thrusters(**options), robot_model())
    rng = np.random.default_rng(seed)
    x = problem.prior_mean.copy()
    x[20:] = 0.01 * rng.normal(size=len(x) - 20)
    for states in (problem.at("thrust_delay"), problem.at("thrust_rise")):
        x[states] = 2e-3 * rng.normal(size=len(CORNERS))
    return problem, x, firing(random_block(seed), seed)


def share(t_s: float, block: Block, k: int, delay_s: float, rise_s: float) -> float:
    """The force of thruster k at a time from the window's centre, by its definition."""
    total = 0.0
    for owner, at_s, sign in block.edges:
        s = t_s - at_s - delay_s
        if owner == k and sign and s > 0.0:
            total += sign * (1.0 - np.exp(-s / rise_s))
    return total


def test_nodes_hold_the_projections_of_force_and_impulse() -> None:
    problem, x, block = case()
    found, half = problem.switched.profile(block, x), WINDOW_S / 2
    points = legendre.leggauss(NODES)[0]
    delay = problem.switched.delay_s + x[problem.at("thrust_delay")]
    rise = problem.switched.rise_s + x[problem.at("thrust_rise")]
    for k in range(len(CORNERS)):
        own = block.edges[(block.edges[:, 0] == k) & (block.edges[:, 2] != 0), 1] + delay[k]
        breaks = [t for t in own if abs(t) < half]

        def integral(f: Any, breaks: list[float] = breaks) -> float:
            at = np.unique([-half, *breaks, half])
            return sum(quad(f, a, b, epsabs=1e-13, limit=200)[0] for a, b in pairwise(at))

        def force(t: float, k: int = k) -> float:
            return share(t, block, k, delay[k], rise[k])

        moments = [
            integral(lambda t, j=j: legendre.legval(t / half, np.eye(NODES)[j]) * force(t))
            for j in range(NODES)
        ]
        want = legendre.legvander(points, NODES - 1) @ (
            (np.arange(NODES) + 0.5) * np.array(moments) / half
        )
        np.testing.assert_allclose(found.u[0, :, k], want, atol=1e-8)
        # by parts: the integral of P_j times the impulse, P_j's own integral Q_j being known
        whole = integral(force)
        shifted = []
        for j in range(NODES):
            Q = legendre.legint(np.eye(NODES)[j])
            end = legendre.legval(1.0, Q) * whole
            inner = integral(lambda t, Q=Q: legendre.legval(t / half, Q) * force(t))
            shifted.append(half * (end - inner))
        want = legendre.legvander(points, NODES - 1) @ (
            (np.arange(NODES) + 0.5) * np.array(shifted) / half
        )
        np.testing.assert_allclose(found.U_s[0, :, k], want, atol=1e-9)
        np.testing.assert_allclose(found.whole_s[0, k], whole, atol=1e-9)


def test_the_time_open_becomes_the_impulse_before() -> None:
    """A valve open for 1 s, closed 0.35 s before the window's start and after delay and rise."""
    problem, x, block = case()
    x[:] = problem.prior_mean
    k, delay, rise = 2, problem.switched.delay_s[2], problem.switched.rise_s[2]
    start = -WINDOW_S / 2
    block = replace(block, opened_s=np.full(len(CORNERS), 1.0))
    late = replace(block, edges=edges_of([(k, start - 1.003, start - 0.003)], 0.0))
    # closed 3 ms before the start: less the delay of 5 ms nothing has fallen yet
    opened = 1.003 - delay - rise * (1.0 - np.exp(-(1.003 - delay) / rise))
    assert problem.switched.profile(late, x).before_s[k] == pytest.approx(opened, abs=1e-12)
    long_ago = replace(block, edges=edges_of([], 0.0))
    assert problem.switched.profile(long_ago, x).before_s[k] == 1.0


@pytest.mark.parametrize("rate", ["momentum", "measured"])
def test_state_jacobians_are_the_derivatives(rate: Any) -> None:
    problem, x, block = case()
    assert problem.names[problem.at("thrust_delay").start] == "thrust_delay.thruster1"
    small = problem.at("thrust_delay").start
    assert_state_slopes(
        lambda x: predict(block, x, problem, rate),
        x,
        lambda k: 1e-6 if k >= small else 1e-5 * max(1.0, abs(x[k])),
        **ACROSS,
        of_slope=1e-6,
        rounding=1e-10,
        fields=predicted_fields(rate),
    )


@pytest.mark.parametrize("weighting", ["ols", "wls", "eiv"])
def test_mrnea_takes_the_force_off(weighting: str) -> None:
    """The unwhitened residual of the base rows falls by the wrench, its slope is the Jacobian."""
    problem, x, block = case()
    block = replace(block, edges=edges_of([(3, -2.0, np.inf), (5, -2.0, np.inf)], 0.0))
    closed = replace(block, edges=edges_of([], 0.0))
    rows, without = (mrnea_rows(b, x, problem, weighting) for b in (block, closed))
    k = problem.at("thrust_scale")
    gain = 1.0 + x[k]
    # whitened alike but for eiv's noise, which does not know of the force either
    change = rows.b - without.b
    np.testing.assert_allclose(rows.A[:, k] @ gain, -change, atol=1e-9 * np.abs(change).max())
    assert np.abs(change).max() > 1.0


def test_momentum_is_carried_over_a_gap_by_the_time_open() -> None:
    """Four windows of a firing, the middle two missing: the momentum is that of all four."""
    problem, x, block = case(biases=False)
    x[20:] = 0.0
    R = np.broadcast_to(np.eye(3), (NODES, 3, 3))
    quiet = np.zeros((NODES, 7))
    on_s, off_s, half = 0.13, 1.07, WINDOW_S / 2
    G = np.zeros((NODES, 3, 3))

    def window(i: int) -> Block:
        centre = (i + 0.5) * WINDOW_S
        firings = [(1, on_s, off_s)] if centre - half > off_s - 0.4 else [(1, on_s, np.inf)]
        opened = np.zeros(len(CORNERS))
        opened[1] = np.clip(centre - half - on_s, 0.0, off_s - on_s)
        t_ns = round(centre * 1e9) + np.rint(half * 1e9 * legendre.leggauss(NODES)[0])
        return replace(
            block,
            t_ns=t_ns.astype(np.int64),
            q_rad=quiet,
            R_NB=R,
            edges=edges_of(firings, centre),
            opened_s=opened,
        )

    whole = parted = None
    for i in range(4):
        whole = momentum_at_nodes(window(i), x, problem, G, whole)[2]
        if i in (0, 3):
            parted = momentum_at_nodes(window(i), x, problem, G, parted)[2]
    np.testing.assert_allclose(parted.L_Nms, whole.L_Nms, rtol=1e-9)
    total, arm = problem.model.composite(quiet[0]) @ problem.pi(x), problem.switched.ways[:, 1]
    moment = arm[3:] - np.cross(total[1:4] / total[0], arm[:3])
    np.testing.assert_allclose(whole.L_Nms, moment * (off_s - on_s), rtol=1e-9)


def test_a_block_without_attitude_uses_no_momentum_and_mrnea_no_changing_thrust() -> None:
    problem, x, block = case()
    blind = replace(block, has_attitude=False)
    use = row_function("fused", "eiv", problem)(blind, x).use
    assert use is not None
    assert use.tolist() == [True] * 10 + [False] * 3
    assert len(row_function("mrnea", "eiv", problem)(block, x).b) == 7 * NODES
    steady = replace(block, edges=edges_of([(3, -2.0, np.inf)], 0.0))
    assert len(row_function("mrnea", "eiv", problem)(steady, x).b) == 13 * NODES
    with pytest.raises(EstimatorError, match="cannot include firings"):
        row_function("ce", "eiv", problem)
