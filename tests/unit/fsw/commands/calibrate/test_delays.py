"""Delays as states: their rows are the derivative of the residual, and late samples are found."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.commands.calibrate.delays import NAMES, DelayedRows, derivative, with_delays
from fsw.estimators.batch.solver import solve
from fsw.estimators.conditioning.polynomial import gauss_nodes
from fsw.estimators.measurement.row_functions import row_function
from tests.support.estimator_cases import make_problem, noisy, true_block
from tests.support.estimator_cases import motion as motion_of

SIGMA_S = 0.02


def late(by_s: float, count: int = 60):
    """Blocks whose gyro and accelerometer show what was `by_s` before their stamps."""
    history, rng = motion_of("target"), np.random.default_rng(1)
    none = {"torque": np.zeros(7), "acc": np.zeros(3), "gyro": np.zeros(3)}
    blocks = []
    for k in range(count):
        now, then = (
            true_block(history, 1.0 + 0.4 * k, k),
            true_block(history, 1.0 + 0.4 * k - by_s, k),
        )
        moved = replace(
            now,
            w_NB_B_rad_s=then.w_NB_B_rad_s,
            wd_NB_B_rad_s2=then.wd_NB_B_rad_s2,
            f_NS_B_m_s2=then.f_NS_B_m_s2,
        )
        blocks.append(noisy(moved, rng, none))
    return blocks


def test_the_derivative_of_a_cubic_is_exact():
    x = gauss_nodes(4)
    assert derivative(4) @ (1.0 + x - 2.0 * x**2 + 3.0 * x**3) == pytest.approx(
        1.0 - 4.0 * x + 9.0 * x**2
    )


def test_without_a_delay_the_rows_are_the_fused_ones():
    plain = make_problem()
    problem, blocks = with_delays(plain, SIGMA_S), late(0.0, 2)
    made = DelayedRows(problem)(blocks[0], problem.prior_mean)
    known = row_function("fused", "eiv", plain)(blocks[0], plain.prior_mean)
    np.testing.assert_array_equal(made.b, known.b)
    np.testing.assert_array_equal(made.A[:, : -len(NAMES)], known.A)


def test_a_delay_moves_the_residual_by_its_column():
    problem, block = with_delays(make_problem(), SIGMA_S), late(0.0, 2)[1]
    rows, x = DelayedRows(problem), problem.prior_mean
    for k in (-2, -1):
        moved = x.copy()
        moved[k] = 1e-3
        change = rows(block, moved).b - rows(block, x).b
        np.testing.assert_allclose(change, -1e-3 * rows(block, x).A[:, k], rtol=1e-6, atol=1e-12)
        assert np.abs(change).max() > 0.0


@pytest.mark.parametrize("by_s", [0.0, 0.002, -0.004])
def test_late_samples_show_as_a_delay(by_s):
    problem, blocks = with_delays(make_problem(), SIGMA_S), late(by_s)
    solution = solve(problem, DelayedRows(problem), blocks)
    sigma = np.sqrt(np.diag(solution.information.covariance()))
    assert solution.status == "OK"
    assert sigma[-2] < 1e-3
    assert abs(solution.mean[-2] - by_s) < 3.0 * sigma[-2]
    assert abs(solution.mean[-1] - by_s) < 3.0 * sigma[-1]
