"""A body so light that its best values are no body's: a gripper that holds nothing."""

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.estimators.batch.solver import minimise
from fsw.estimators.model.inertia import is_consistent
from fsw.messages import FloatArray
from tests.support.estimator_cases import make_problem

ROWS, DRAWS = 60, 40
MASS_SIGMA_KG = 4.0  # of what the rows say; the prior says 400 +- 200


class Rows:
    """Rows that are linear in the state, and what unit noise makes of a true state."""

    def __init__(self, truth: FloatArray, prior_sigma: FloatArray, seed: int) -> None:
        rng = np.random.default_rng(seed)
        sigma = prior_sigma * MASS_SIGMA_KG / prior_sigma[0]
        self.A = rng.standard_normal((ROWS, len(truth))) / sigma
        self.seen = self.A @ truth + rng.standard_normal(ROWS)

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.A, self.seen - self.A @ x


@pytest.mark.parametrize("unknown", [("target",), ("base", "target")])
def test_nothing_in_the_gripper_has_an_honest_covariance(unknown):
    problem = make_problem(unknown, biases=False)
    truth = problem.prior_mean.copy()
    own = problem.body("target")
    truth[own] = 0.0
    sigma = np.sqrt(np.diag(problem.prior_covariance))
    total, outside = 0.0, 0
    for seed in range(DRAWS):
        solution = minimise(problem, Rows(truth, sigma, seed))  # type: ignore[arg-type]
        assert solution.status == "OK"
        error = solution.mean[own] - truth[own]
        outside += not is_consistent(solution.mean[own])
        total += error @ np.linalg.solve(solution.information.covariance()[own, own], error)
    assert outside > 0.9 * DRAWS, "noise alone decides; a body of positive mass is a rare draw"
    assert chi2.ppf(0.0005, 10 * DRAWS) < total < chi2.ppf(0.9995, 10 * DRAWS)


def test_a_body_that_no_noise_explains_is_not_taken_for_a_light_one():
    problem = make_problem(("target",), biases=False)
    truth = problem.prior_mean.copy()
    truth[0] = -100.0  # 25 sigma of the rows
    rows = Rows(truth, np.sqrt(np.diag(problem.prior_covariance)), 0)
    solution = minimise(problem, rows)  # type: ignore[arg-type]
    assert solution.mean[0] > 0.0
