"""A body so light that its best values are no body's: a gripper that holds nothing."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize
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


def best_body(cost: Callable[[FloatArray], float], scale: FloatArray) -> float:
    """Return the least cost of any pseudo-inertia L L^T, found by another solver (BFGS)."""
    lower = np.tril_indices(4)

    def parameters(v: FloatArray) -> FloatArray:
        L = np.zeros((4, 4))
        L[lower] = v
        pseudo = L @ L.T
        S, h, mass = pseudo[:3, :3], pseudo[:3, 3], pseudo[3, 3]
        inertia = np.trace(S) * np.eye(3) - S
        own = inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]  # xx xy yy xz yz zz
        return np.concatenate([[mass], h, own])

    start = np.diag([0.1, 0.1, 0.1, 1.0])[lower] * np.sqrt(scale[0])
    found = minimize(lambda v: cost(parameters(v)), start, method="BFGS", tol=1e-10)
    return float(found.fun)


def test_a_body_that_no_noise_explains_ends_at_the_edge_of_the_bodies_and_is_named():
    """The least cost lies at the edge, which is infinitely far in the body's own coordinates."""
    problem = make_problem(("target",), biases=False)
    truth = problem.prior_mean.copy()
    truth[0] = -100.0  # 25 sigma of the rows
    sigma = np.sqrt(np.diag(problem.prior_covariance))
    rows = Rows(truth, sigma, 0)
    solution = minimise(problem, rows)  # type: ignore[arg-type]
    assert solution.status == "OK"
    assert is_consistent(solution.mean)

    def cost(x: FloatArray) -> float:
        b = rows(x)[1]
        return float(b @ b) + problem.prior.cost(x)

    assert solution.cost < best_body(cost, sigma) * (1.0 + 1e-4)
    assert "target" in solution.note
    assert "mass of -9" in solution.note or "mass of -10" in solution.note, solution.note


def test_what_still_moves_is_named_when_the_iterations_are_used_up():
    """Rows that see a bias turn with the iterate: no point is stationary."""
    problem = make_problem(("target",))
    turned = iter(range(1000))
    moving = problem.names.index("torque_offset.joint1")

    def rows(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        A = np.zeros((1, len(x)))
        A[0, moving] = 1e3
        return A, np.array([1e3 * (-1.0) ** next(turned)])

    solution = minimise(problem, rows)
    assert solution.status == "NOT_CONVERGED"
    assert "torque offsets (joint1) still moves" in solution.note
