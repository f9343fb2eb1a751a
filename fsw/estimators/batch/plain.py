"""Plain steps of a batch: its solution, and where the best values are those of no body.

The best values of a light body, as of an empty gripper, often lie just outside the consistent ones:
if noise alone explains this, they are the solution, and the published body is marked as
inconsistent. If noise does not, the least cost lies at the edge of the consistent bodies.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from fsw.errors import EstimatorError
from fsw.estimators.model.inertia import (
    from_log_cholesky,
    is_consistent,
    nearest_consistent,
    to_log_cholesky,
)
from fsw.estimators.model.prior import Prior
from fsw.estimators.model.problem import Problem
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import FloatArray

MAX_PLAIN_STEPS = 40  # up to 18 were needed from starts that were 30-50 % wrong
PATIENCE = 10  # steps; if none of them is shorter by a tenth than all before, they do not settle
CONVERGED = 1e-3  # whitened rms step at which the iteration stops
COST_RISE = 1e-3  # relative; a step between consistent bodies with a larger rise is halved
HALVINGS = 10
NOISE_PROBABILITY = 1e-3  # that noise alone moves a body so far out of the consistent ones
WEAKEST_GAIN = (
    0.5  # prior variance over posterior variance, minus one, of the least known direction
)

# rows A (k, p) and b (k,) at a state
RowsAt = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BatchSolution:
    """A batch estimate: status is OK, NOT_CONVERGED, INSUFFICIENT_EXCITATION or ABORTED."""

    status: str
    mean: FloatArray  # (p,)
    information: SquareRootInformation
    iterations: int
    cost: float  # sum of squared whitened residuals, prior included
    note: str = ""  # what runs away: a body from the possible ones, or the state that still moves


class _Lengths:
    """Lengths of the steps so far."""

    def __init__(self) -> None:
        self._least, self._since = np.inf, 0

    def stagnate(self, length: float) -> bool:
        """Add a step's length; return whether steps have stopped getting shorter."""
        self._since = 0 if length < 0.9 * self._least else self._since + 1
        self._least = min(self._least, length)
        return self._since >= PATIENCE


def gauss_newton(
    problem: Problem, target: RowsAt, prior: Prior, start: FloatArray
) -> tuple[FloatArray, bool]:
    """Return where undamped steps in the linear parameters settle; else the start and False.

    Far from the solution the covariance of errors-in-variables rows grows with the parameters, and
    a search by cost can prefer too heavy bodies; plain steps with re-weighting do not. Rows are
    evaluated at the nearest consistent bodies.
    """
    x, lengths = start, _Lengths()
    for _ in range(MAX_PLAIN_STEPS):
        at = to_x(problem, to_theta(problem, x))
        try:
            x, moved, _ = plain_step(target, prior, x, at)
        except (EstimatorError, np.linalg.LinAlgError):
            return start, False
        if moved < CONVERGED:
            return x, True
        if lengths.stagnate(moved):
            break
    return start, False


def plain_step(
    target: RowsAt, prior: Prior, x: FloatArray, at: FloatArray
) -> tuple[FloatArray, float, SquareRootInformation]:
    """Make one step from x (p,) with the rows linearised at `at` (p,).

    Returns
    -------
    The minimum (p,), the whitened rms of the step to it, and the information.
    """
    A, b = target(at)
    information = prior.at(at).update(A, b + A @ at)
    mean = information.mean()
    step = information.R @ (mean - x)
    return mean, float(np.sqrt(step @ step / len(x))), information


def plain_solution(
    problem: Problem, target: RowsAt, prior: Prior, start: FloatArray
) -> tuple[FloatArray, BatchSolution | None]:
    """Return a start for a search over consistent bodies, and the solution if one is found here.

    The start (p,) is where plain steps settle, or else `start`. A solution is found if the best
    values are those of no possible body: see `light` and `at_the_edge`.
    """
    x, settled = gauss_newton(problem, target, prior, start)
    possible = all(is_consistent(x[problem.body(name)]) for name in problem.unknown)
    # steps with rows at the nearest consistent bodies can swing about a body of almost no mass
    found = None if possible else light(problem, target, prior, x)
    if found is None and not (settled and possible):
        return at_the_edge(problem, target, prior, x)
    return x, found


def light(problem: Problem, target: RowsAt, prior: Prior, x: FloatArray) -> BatchSolution | None:
    """Return the solution where noise alone explains why a body's best values are inconsistent.

    None: the base is not consistent, or noise does not explain one of the bodies.
    """
    iterations, moved, lengths = 0, np.inf, _Lengths()
    while moved >= CONVERGED and iterations < MAX_PLAIN_STEPS:
        iterations += 1
        try:
            x, moved, information = plain_step(target, prior, x, x)
        except (EstimatorError, np.linalg.LinAlgError):
            return None
        if lengths.stagnate(moved):
            return None
    if moved >= CONVERGED or _unexplained(problem, x, information.covariance()):
        return None
    return _solution(problem, target, prior, x, iterations, "")


def at_the_edge(
    problem: Problem, target: RowsAt, prior: Prior, start: FloatArray
) -> tuple[FloatArray, BatchSolution | None]:
    """Return where steps over the consistent bodies settle, and the solution if their edge has it.

    If the steps do not settle, return the start and None.
    """
    x = to_x(problem, to_theta(problem, start))
    cost, lengths = _tried(target, prior, x), _Lengths()
    for iterations in range(1, MAX_PLAIN_STEPS + 1):
        try:
            best, _, information = plain_step(target, prior, x, x)
            covariance = information.covariance()
            whole = _nearest(problem, best, covariance) - x
        except (EstimatorError, np.linalg.LinAlgError):
            return start, None
        step = information.R @ whole
        if step @ step < CONVERGED**2 * len(x):
            outside = _unexplained(problem, best, covariance)
            note = "; ".join(_wanted(name, best[problem.body(name)]) for name in outside)
            if not outside:
                return x, None
            return x, _solution(problem, target, prior, x, iterations, note)
        if lengths.stagnate(float(np.sqrt(step @ step))):
            break
        # re-weighted rows have their solution near the least cost, not at it
        most = cost + max(1.0, COST_RISE * cost)
        for halved in range(HALVINGS):
            trial = x + 0.5**halved * whole
            cost = _tried(target, prior, trial)
            if cost <= most:
                break
        x = trial
    return start, None


def _tried(target: RowsAt, prior: Prior, x: FloatArray) -> float:
    """Return the cost at a state, infinite where nothing can be predicted."""
    try:
        return cost_of(prior, x, target(x)[1])
    except np.linalg.LinAlgError:
        return np.inf


def _nearest(problem: Problem, x: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the likeliest state with consistent bodies, by a Gaussian about x (p,)."""
    for name in problem.unknown:
        k = problem.body(name)
        if not is_consistent(x[k]):
            own = covariance[k, k]
            shift = nearest_consistent(x[k], own) - x[k]
            x = x + covariance[:, k] @ np.linalg.solve(own, shift)
    return x


def _unexplained(problem: Problem, x: FloatArray, covariance: FloatArray) -> list[str]:
    """Return the bodies whose values are inconsistent beyond noise; the base needs no noise."""
    found = []
    for name in problem.unknown:
        k = problem.body(name)
        if is_consistent(x[k]):
            continue
        off = x[k] - nearest_consistent(x[k], covariance[k, k])
        far = off @ np.linalg.solve(covariance[k, k], off)
        if name == "base" or far > chdtri(len(off), NOISE_PROBABILITY):
            found.append(name)
    return found


def _wanted(name: str, pi: FloatArray) -> str:
    want = f"a mass of {pi[0]:.3g} kg" if pi[0] <= 0.0 else "moments of inertia that no body has"
    return f"the data want {want} for the {name}"


def _solution(
    problem: Problem, target: RowsAt, prior: Prior, x: FloatArray, iterations: int, note: str
) -> BatchSolution:
    A, b = target(x)
    excited = weakest_gain(problem, A) >= WEAKEST_GAIN
    return BatchSolution(
        status="OK" if excited else "INSUFFICIENT_EXCITATION",
        mean=x,
        information=prior.at(x).update(A, b + A @ x),
        iterations=iterations,
        cost=cost_of(prior, x, b),
        note=note,
    )


def cost_of(prior: Prior, x: FloatArray, b: FloatArray) -> float:
    """Return the sum of squared whitened residuals b (k,), the prior's at x (p,) included."""
    return float(b @ b) + prior.cost(x)


def to_theta(problem: Problem, x: FloatArray) -> FloatArray:
    """Return the state (p,) with ten log-Cholesky values in place of each unknown body's pi.

    A body that cannot exist is replaced by the nearest one that can.
    """
    theta = x.copy()
    for name in problem.unknown:
        k = problem.body(name)
        pi = x[k]
        if not is_consistent(pi):
            pi = nearest_consistent(pi, problem.prior_covariance[k, k])
        theta[k] = to_log_cholesky(pi)
    return theta


def to_x(problem: Problem, theta: FloatArray) -> FloatArray:
    """Return the state (p,) whose bodies are given as log-Cholesky values; see `to_theta`."""
    x = theta.copy()
    for name in problem.unknown:
        x[problem.body(name)] = from_log_cholesky(theta[problem.body(name)])
    return x


def weakest_gain(problem: Problem, stacked: FloatArray) -> float:
    """Return the data's information over the prior's in the least known direction of the bodies.

    `stacked` (k, p) are whitened rows of the data; other states are marginalised with their priors.
    """
    k, prior = problem.shown, problem.prior_covariance
    F = stacked.T @ stacked
    others = np.setdiff1d(np.arange(len(F)), k)
    if len(others):
        D = F + np.linalg.solve(prior, np.eye(len(F)))
        across = D[np.ix_(k, others)]
        D_others = D[np.ix_(others, others)]
        own = D[np.ix_(k, k)] - across @ np.linalg.solve(D_others, across.T)
        P = prior[np.ix_(k, k)]
        F = own - np.linalg.solve(P, np.eye(len(k)))
    else:
        P = prior
    L = np.linalg.cholesky(P)
    return float(np.linalg.eigvalsh(L.T @ F @ L)[0])
