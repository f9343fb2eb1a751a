"""The damped solver: how many rows it asks for, and where it ends."""

import numpy as np
import pytest

from fsw.estimators.batch.plain import MAX_PLAIN_STEPS, PATIENCE, gauss_newton, light
from fsw.estimators.batch.solver import MAX_ITERATIONS, minimise
from fsw.messages import FloatArray
from tests.support.estimator_cases import make_problem


def test_where_plain_steps_have_settled_no_rows_are_asked_for_again() -> None:
    """Linear rows: one plain step, one that settles, and the rows at the end; none of a trial."""
    problem = make_problem(("target",), biases=False)
    rng = np.random.default_rng(0)
    sigma = np.sqrt(np.diag(problem.prior_covariance))
    A = rng.standard_normal((60, len(sigma))) / (0.01 * sigma)
    seen = A @ problem.prior_mean + rng.standard_normal(60)
    asked = []

    def rows(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        asked.append(x)
        return A, seen - A @ x

    solution = minimise(problem, rows)
    assert solution.status == "OK"
    assert len(asked) <= 3
    known = problem.prior.at(solution.mean)
    J = np.vstack([A, known.R])
    r = np.concatenate([seen, known.z]) - J @ solution.mean
    left = np.linalg.qr(J)[0].T @ r  # the step that is left [sigma]
    assert np.abs(left).max() < 1e-5


def test_steps_that_swing_about_end_long_before_the_last_one() -> None:
    """Rows that want another state at every step can never settle."""
    problem = make_problem(("target",), biases=False)
    sigma = np.sqrt(np.diag(problem.prior_covariance))
    A = np.diag(1e4 / sigma)
    asked = []

    def rows(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        asked.append(x)
        side = 1.0 if len(asked) % 2 else -1.0
        return A, A @ (problem.prior_mean + side * 0.01 * sigma - x)

    assert gauss_newton(problem, rows, problem.prior, problem.prior_mean)[1] is False
    assert len(asked) <= PATIENCE + 2 < MAX_PLAIN_STEPS
    asked.clear()
    assert light(problem, rows, problem.prior, problem.prior_mean) is None
    assert len(asked) <= PATIENCE + 2


@pytest.mark.parametrize(
    ("strain", "stiffness", "status", "least", "most"),
    [
        (50.0, 15.0, "NOT_CONVERGED", PATIENCE, 2 * PATIENCE),  # no doubt explains 50 sigma
        (50.0, 2.0, "OK", 2 * PATIENCE, MAX_ITERATIONS),  # it gets there in time
        (0.5, 15.0, "NOT_CONVERGED", MAX_ITERATIONS, MAX_ITERATIONS),  # the prior explains it
    ],
)
def test_a_crawl_that_nothing_explains_ends_early(strain, stiffness, status, least, most) -> None:
    """Rows that fit everywhere hold the sensors' states, so that steps to the prior are short."""
    problem = make_problem(("target",))
    sigma = np.sqrt(np.diag(problem.prior_covariance))
    start = problem.prior_mean.copy()
    start[problem.bodies.stop :] += strain * sigma[problem.bodies.stop :]
    weights = stiffness / sigma
    weights[problem.bodies] = 100.0 / sigma[problem.bodies]

    def rows(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        off = weights * (problem.prior_mean - x)
        off[problem.bodies.stop :] = 0.0
        return np.diag(weights), off

    found = minimise(problem, rows, start=start, plain=False)
    assert found.status == status
    assert least <= found.iterations <= most
