"""Friction as part of the state: derivatives, at reversals too, in every method's rows."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fsw.config import Config
from fsw.estimators.conditioning import reversal
from fsw.estimators.conditioning.polynomial import gauss_nodes
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from tests.support.estimator_cases import NODES, N, make_config, random_block, robot_model
from tests.support.one_block import energy_rows, mrnea_rows
from tests.support.slopes import (
    TORQUE,
    assert_row_slopes,
    assert_state_slopes,
    named,
    off_the_prior,
)

SPEED = 0.05


def with_friction(config: Config, coulomb: float = 0.3, viscous: float = 0.5) -> Config:
    update = {
        "friction_coulomb_sigma_nm": coulomb,
        "friction_viscous_sigma_nms_rad": viscous,
        "friction_speed_rad_s": SPEED,
    }
    return config.model_copy(
        update={"joints": [joint.model_copy(update=update) for joint in config.joints]}
    )


def problem_and_state(*, doubt: bool = True) -> tuple[Problem, np.ndarray]:
    problem = build_problem(with_friction(make_config(doubt=doubt)), robot_model())
    x = off_the_prior(problem)
    x[problem.inertial] = problem.prior_mean[problem.inertial]
    return problem, x


def reversing_block() -> Block:
    """Return a block in which every joint reverses, three of them exactly at a node."""
    block, nodes = random_block(2), gauss_nodes(NODES)
    at = np.array([nodes[0], nodes[1], nodes[2], -0.2, 0.0, 0.5, 0.9])
    return replace(block, qd_rad_s=0.2 * (nodes[:, None] - at))


@pytest.mark.parametrize("block", [random_block(2), reversing_block()])
@pytest.mark.parametrize("rate", ["momentum", "measured"])
def test_predictions_derivatives_by_the_state(block: Block, rate: Any) -> None:
    problem, x = problem_and_state()
    assert_state_slopes(
        lambda x: predict(block, x, problem, rate),
        *(x, 1e-5),
        rtol=0.0,
        of_slope=1e-6,
        fields=TORQUE,
        states=named(problem, "friction", "torque"),
    )


@pytest.mark.parametrize("block", [random_block(2), reversing_block()])
def test_predictions_derivative_by_a_nodes_own_rate(block: Block) -> None:
    problem, x = problem_and_state()
    D, h = predict(block, x, problem, "momentum").D_qd[:, :N], 1e-6
    for node in range(NODES):
        for j in range(N):
            step = np.zeros_like(block.qd_rad_s)
            step[node, j] = h
            up, down = (
                predict(replace(block, qd_rad_s=block.qd_rad_s + s * step), x, problem, "momentum")
                for s in (1.0, -1.0)
            )
            expected = (up.tau_nm - down.tau_nm)[node] / (2 * h)
            assert np.abs(D[node, :, j] - expected).max() <= 1e-5 * np.abs(D[node]).max()


@pytest.mark.parametrize("block", [random_block(4), reversing_block()])
def test_rows_of_the_regression_and_of_energy(block: Block) -> None:
    """Where weights do not follow the state A = -db/dx."""
    problem, x = problem_and_state(doubt=False)
    own = named(problem, "friction")
    assert len(own) == 2 * N
    assert_row_slopes(lambda x: mrnea_rows(block, x, problem, "ols"), x, 1e-5, own, of_slope=1e-6)
    # torque so noisy that the weights do not follow the state
    quiet = replace(block, cov_tau=1e12 * block.cov_tau)
    spans = replace(quiet, t_ns=np.rint(2e8 * (1.0 + gauss_nodes(NODES))).astype(np.int64))
    assert_row_slopes(lambda x: energy_rows(spans, x, problem), x, 1e-5, own, of_slope=1e-5)


def test_shape_is_the_windows_fit_of_many_samples() -> None:
    """Friction added to samples and fitted as the conditioner does, against the shape."""
    block = reversing_block()
    t = (2.0 * np.arange(2000) + 1.0) / 2000 - 1.0
    at = np.array([gauss_nodes(NODES)[0], gauss_nodes(NODES)[1], 0.5])
    samples = np.tanh(0.2 * (t[:, None] - at) / SPEED)
    fit = np.polynomial.legendre.legfit(t, samples, NODES - 1)
    expected = np.polynomial.legendre.legval(gauss_nodes(NODES), fit).T
    s = BlockStack((block,))
    shape = reversal.shape(s.by_block(s.qd_rad_s), np.full(N, SPEED))[0][0]
    np.testing.assert_allclose(shape[:, [0, 1, 5]], expected, atol=2e-3)


def test_doubt_is_whole_at_rest_and_none_in_motion() -> None:
    rest, fast = np.zeros((NODES, 1)), np.full((NODES, 1), 20.0 * SPEED)
    speed = np.array([SPEED])
    np.testing.assert_allclose(reversal.doubt(rest, speed)[0], 1.0, atol=1e-12)
    assert np.abs(reversal.doubt(fast, speed)).max() < 1e-6


def test_no_friction_is_no_state_and_changes_no_bit() -> None:
    """Sigmas of zero leave the speed without effect: same states, same rows to the bit."""
    plain = make_config(doubt=True)
    none = with_friction(plain, 0.0, 0.0)
    problem, other = (build_problem(config, robot_model()) for config in (plain, none))
    assert problem.names == other.names
    assert not [name for name in problem.names if name.startswith("friction")]
    block, x = random_block(2), problem.prior_mean + 1e-3
    a, b = (predict(block, x, p, "momentum") for p in (problem, other))
    assert a.J.tobytes() == b.J.tobytes()
    assert a.tau_nm.tobytes() == b.tau_nm.tobytes()
