"""The motion joined at the edges of windows: dense algebra, polynomials, what breaks the chain."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from fsw.estimators.batch.settle import fit
from fsw.estimators.conditioning.polynomial import gauss_nodes
from fsw.estimators.measurement import continuity
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.continuity import edge_operator
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.motion_noise import by_motion, residual_covariance
from fsw.estimators.measurement.row_functions import linearised, row_function
from fsw.messages import Block, FloatArray
from tests.support.estimator_cases import NODES, WINDOW_S, N, make_problem, noisy_blocks
from tests.support.one_block import fused_rows

HALF_S = WINDOW_S / 2
COUNT = 5
EVERY = np.ones(N + 6, np.bool_)


def run(blocks: list[Block], fits: tuple[bool, ...] = ()):
    problem = make_problem()
    rows = row_function("fused", "eiv", problem)
    return linearised(rows, blocks, problem.prior_mean, None, fits)[0]


@pytest.mark.parametrize("nodes", range(2, 9))
def test_edges_of_polynomials_are_exact(nodes: int) -> None:
    """Against numpy's polynomials of the degree of a position's fit."""
    rng = np.random.default_rng(1)
    for _ in range(5):
        p = Polynomial(rng.normal(size=nodes + 3))
        t = HALF_S * gauss_nodes(nodes)
        z = np.stack([p.deriv()(t), p.deriv(2)(t), p(t)])
        got = np.einsum("fdi,di->f", edge_operator(nodes, HALF_S), z)
        want = [p(-HALF_S), p.deriv()(-HALF_S), p(HALF_S), p.deriv()(HALF_S)]
        np.testing.assert_allclose(got, want, rtol=1e-9)


def dense(blocks: list[Block]) -> tuple[FloatArray, FloatArray]:
    """Return A^T S^-1 A and A^T S^-1 b of all rows of adjoining blocks with one dense covariance.

    Rows: channels of every block, then the steps of position and rate at every inner edge.
    """
    problem = make_problem()
    x, m, k, E = problem.prior_mean, NODES, NODES * (N + 6), edge_operator(NODES, HALF_S)
    E = E.reshape(4, -1)
    count = len(blocks)
    edges = 2 * N * (count - 1)
    S = np.zeros((k * count + edges, k * count + edges))
    b, A = np.zeros(len(S)), np.zeros((len(S), len(x)))
    H = np.zeros((len(S), count * N * 3 * m))  # by the errors of every joint's fit
    P = np.zeros((H.shape[1], H.shape[1]))
    for i, block in enumerate(blocks):
        s = BlockStack((block,))
        at = predict(s, x, problem)
        own = slice(i * k, (i + 1) * k)
        quiet = BlockStack((replace(block, cov_joint=0.0 * block.cov_joint),))
        S[own, own] = residual_covariance(quiet, at, EVERY, "momentum")[0]
        parts = (
            block.tau_nm - at.tau_nm,
            block.f_NS_B_m_s2 - at.f_m_s2,
            block.w_NB_B_rad_s - at.w_rad_s,
        )
        b[own], A[own] = np.concatenate(parts, axis=1).ravel(), at.J.reshape(k, -1)
        D = by_motion(at)
        for j in range(N):
            first = (i * N + j) * 3 * m
            P[first : first + 3 * m, first : first + 3 * m] = block.cov_joint[j]
            for d in range(len(D)):
                for node in range(m):
                    rows = slice(own.start + node * (N + 6), own.start + (node + 1) * (N + 6))
                    H[rows, first + d * m + node] = -D[d, node, :, j]
            z = np.concatenate([block.qd_rad_s[:, j], block.qdd_rad_s2[:, j], block.q_rad[:, j]])
            if i:
                before = k * count + (i - 1) * 2 * N + 2 * j
                H[before : before + 2, first : first + 3 * m] = E[:2]
                b[before : before + 2] += E[:2] @ z
            if i < count - 1:
                after = k * count + i * 2 * N + 2 * j
                H[after : after + 2, first : first + 3 * m] = -E[2:]
                b[after : after + 2] -= E[2:] @ z
    L = np.linalg.cholesky(S + H @ P @ H.T)
    A, b = np.linalg.solve(L, A), np.linalg.solve(L, b)
    return A.T @ A, A.T @ b


@pytest.fixture
def explained(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take residuals as noise, though the prior's mean is not the truth."""
    monkeypatch.setattr(continuity, "NOISE_POWER", np.inf)


def test_what_noise_does_not_explain_hands_on_little() -> None:
    """At the prior's mean: the covariance of the end is as much larger as the residuals' power."""
    blocks = noisy_blocks("target", 3, 8.0)[10:12]
    first = run(blocks)[0]
    power = float(np.mean(first.b**2))
    assert power > continuity.NOISE_POWER
    assert first.after is not None
    E = edge_operator(NODES, HALF_S).reshape(4, -1)[2:]
    plain = E @ blocks[0].cov_joint[0] @ E.T
    assert first.after.cov_motion[0, 0] == pytest.approx(
        power / continuity.NOISE_POWER * plain[0, 0], rel=0.5
    )


@pytest.mark.usefixtures("explained")
def test_a_run_of_blocks_is_one_problem() -> None:
    """Block by block, the information is that of one dense covariance of all rows."""
    blocks = noisy_blocks("target", 3, 8.0)[10 : 10 + COUNT]
    made = run(blocks)
    assert [one.edge for one in made] == [0] + [2 * N] * (COUNT - 1)
    F = sum(one.A.T @ one.A for one in made)
    g = sum(one.A.T @ one.b for one in made)
    want_F, want_g = dense(blocks)
    scale = np.sqrt(np.diag(want_F))
    np.testing.assert_allclose(
        F / np.outer(scale, scale), want_F / np.outer(scale, scale), atol=1e-6
    )
    np.testing.assert_allclose(
        g / scale, want_g / scale, rtol=1e-5, atol=1e-5 * np.abs(g / scale).max()
    )


def test_rows_of_nodes_are_those_without_the_edge() -> None:
    blocks = noisy_blocks("target", 4, 8.0)[10 : 10 + COUNT]
    problem = make_problem()
    for one, block in zip(run(blocks), blocks, strict=True):
        alone = fused_rows(block, problem.prior_mean, problem)
        nodes = one.at_nodes
        np.testing.assert_allclose(nodes.b, alone.b, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(nodes.A, alone.A, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(nodes.root, alone.root, rtol=1e-12, atol=0.0)


def test_a_gap_parts_the_motion() -> None:
    blocks = noisy_blocks("target", 5, 8.0)
    made = run([*blocks[10:12], *blocks[13:15]])
    assert [one.edge for one in made] == [0, 2 * N, 0, 2 * N]


def test_a_block_that_does_not_fit_hands_on_no_motion() -> None:
    blocks = noisy_blocks("target", 6, 8.0)[10:14]
    wild = replace(blocks[1], tau_nm=blocks[1].tau_nm + 50.0)
    made = run([blocks[0], wild, *blocks[2:]], (True, False, True, True))
    again = run(blocks[2:])
    assert [one.edge for one in made] == [0, 2 * N, 0, 2 * N]
    for one, alone in zip(made[2:], again, strict=True):
        assert np.array_equal(one.A, alone.A)
        assert np.array_equal(one.b, alone.b)


@pytest.mark.usefixtures("explained")
@pytest.mark.parametrize("jump", ["angle", "rate"])
def test_a_jump_between_windows_shows(jump: str) -> None:
    """A step of ten sigmas of the fit at the edge: the rows of the edge are far off, those of the
    nodes are not."""
    blocks = noisy_blocks("target", 7, 8.0)[10:12]
    E, which = edge_operator(NODES, HALF_S).reshape(4, -1), 0 if jump == "angle" else 1
    sigma = float(np.sqrt(E[which] @ blocks[1].cov_joint[2] @ E[which]))
    step = np.zeros(N)
    step[2] = 10.0 * sigma
    t = (HALF_S * (1.0 + gauss_nodes(NODES)))[:, None] if jump == "rate" else np.ones((NODES, 1))
    by_rate = step if jump == "rate" else 0.0 * step
    moved = replace(
        blocks[1], q_rad=blocks[1].q_rad + t * step, qd_rad_s=blocks[1].qd_rad_s + by_rate
    )
    before, after = (run([blocks[0], block])[1] for block in (blocks[1], moved))
    k = len(after.b) - after.edge
    assert float(np.sum(after.b[k:] ** 2) - np.sum(before.b[k:] ** 2)) > 20.0


def test_only_the_first_of_a_run_is_left_out_if_the_edges_alone_are_off() -> None:
    """Seven windows: one is off at its nodes, and the two after it at their edges; one alone."""
    good, nodes, edge = np.ones(66), np.ones(66), np.ones(66)
    nodes[:52], edge[52:] = 9.0, 30.0
    found = [(good, 0), (nodes, 14), (edge, 14), (edge, 14), (good, 14), (edge, 14), (good, 14)]
    assert fit(found, 1.0, 1e-6) == [True, False, True, True, True, False, True]
