"""Batch identification of stored blocks by any method: damped Gauss-Newton over consistent bodies.

The unknown bodies are iterated in log-Cholesky coordinates, so every iterate is physically possible
and the base's inertia never becomes singular; the covariance is given in the linear parameters.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np
from scipy.special import chdtri

from fsw.estimators.batch.curvature import STIFF, WEAK, Widening, widen
from fsw.estimators.measurement.row_functions import Linearisation, RowsFunction
from fsw.estimators.model.inertia import (
    from_log_cholesky,
    is_consistent,
    log_cholesky_jacobian,
    nearest_consistent,
    to_log_cholesky,
)
from fsw.estimators.model.mobility import NOTE, by_mobility, is_bent
from fsw.estimators.model.prior import Prior
from fsw.estimators.model.problem import Problem
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import Block, FloatArray
from fsw.messages.errors import EstimatorError

MAX_ITERATIONS = 60
MAX_PLAIN_STEPS = 40  # up to 18 were needed from starts that were 30-50 % wrong
PROFILE_ITERATIONS = 4  # of every point of a profile
CONVERGED = 1e-3  # whitened rms step at which the iteration stops
NEGLIGIBLE = 1e-6  # whitened rms step after which the rows are not evaluated again
DAMPING = 1e-3  # initial
NOISE_PROBABILITY = 1e-3  # that noise alone moves a body so far out of the consistent ones
WEAKEST_GAIN = (
    0.5  # prior variance over posterior variance, minus one, of the least known direction
)

Progress = Callable[[float, str], bool]  # fraction and text; False aborts


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BatchSolution:
    """A batch estimate: status is OK, NOT_CONVERGED, INSUFFICIENT_EXCITATION or ABORTED."""

    status: str
    mean: FloatArray  # (p,)
    information: SquareRootInformation
    iterations: int
    cost: float  # sum of squared whitened residuals, prior included
    rows: int


# rows A (k, p) and b (k,) at a state
RowsAt = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


class Target:
    """Cost of a batch: whitened rows of some blocks at a state, scaled to a noise level.

    Parameters
    ----------
    linear : rows of all blocks
    fits : which blocks count; None: all
    level : variance of the noise over the declared one
    """

    def __init__(
        self, linear: Linearisation, fits: Sequence[bool] | None = None, level: float = 1.0
    ) -> None:
        self._linear, self._fits, self._weight = linear, fits, level**-0.5

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return A (k, p) and b (k,) of all rows."""
        parts = self._linear(x)
        used = parts if self._fits is None else list(compress(parts, self._fits))
        A, b = np.vstack([part.A for part in used]), np.concatenate([part.b for part in used])
        return (A, b) if self._weight == 1.0 else (self._weight * A, self._weight * b)


def solve(
    problem: Problem,
    rows: RowsFunction,
    blocks: Sequence[Block],
    progress: Progress | None = None,
    start: FloatArray | None = None,
) -> BatchSolution:
    """Return `minimise` over the rows of some blocks."""
    return minimise(problem, Target(Linearisation(rows, blocks)), progress, start)


def minimise(
    problem: Problem,
    target: RowsAt,
    progress: Progress | None = None,
    start: FloatArray | None = None,
    max_iterations: int = MAX_ITERATIONS,
    plain: bool = True,
) -> BatchSolution:
    """Minimise the prior's cost plus the squared whitened residuals.

    With `plain`, re-weighted Gauss-Newton comes first. Levenberg-Marquardt over the consistent
    bodies follows, from where Gauss-Newton settles, or else from the start. The best values of a
    light body, as of an empty gripper, often lie just outside the consistent ones: if noise alone
    explains this, they are the solution, and the published body is marked as inconsistent.

    `start` is the first iterate (the prior's mean when None), moved to consistent bodies if needed.
    """
    prior = problem.prior
    x = prior.mean if start is None else start
    if plain:
        x, settled = _gauss_newton(problem, target, prior, x)
        light = _light(problem, target, prior, x) if settled else None
        if light is not None:
            return light
    theta = _to_theta(problem, x)
    x = _to_x(problem, theta)
    damping, iterations, status = DAMPING, 0, "NOT_CONVERGED"
    stacked, b = target(x)
    cost = _cost(prior, x, b)
    while iterations < max_iterations:
        iterations += 1
        known = prior.at(x)
        J = np.vstack([stacked, known.R]) @ _chain(problem, theta)
        r = np.concatenate([b, known.z - known.R @ x])
        N, g = J.T @ J, J.T @ r
        if not np.all(np.isfinite(N)):
            break
        accepted = False
        while not accepted and damping < 1e10:
            step = np.linalg.solve(N + damping * np.diag(np.diag(N)), g)
            moved = float(np.sqrt(step @ N @ step / len(step)))
            if moved < NEGLIGIBLE and damping <= DAMPING:
                trial_theta, trial, trial_stacked, trial_b, trial_cost = theta, x, stacked, b, cost
                accepted = True
                break
            trial_theta = theta + _bounded(problem, step)
            trial = _to_x(problem, trial_theta)
            try:
                trial_stacked, trial_b = target(trial)
                trial_cost = _cost(prior, trial, trial_b)
            except np.linalg.LinAlgError:  # so far off that nothing can be predicted
                trial_cost = np.inf
            accepted = trial_cost <= cost * (1 + 1e-9)
            damping = max(damping / 10, 1e-12) if accepted else damping * 10
        if not accepted:
            break
        theta, x, stacked, b, cost = trial_theta, trial, trial_stacked, trial_b, trial_cost
        if progress is not None and not progress(
            min(1.0, iterations / 10), f"iteration {iterations}: step {moved:.2g} sigma"
        ):
            status = "ABORTED"
            break
        if moved < CONVERGED:
            status = "OK"
            break
    if status == "OK" and _weakest_gain(problem, stacked) < WEAKEST_GAIN:
        status = "INSUFFICIENT_EXCITATION"
    return BatchSolution(
        status=status,
        mean=x,
        information=prior.at(x).update(stacked, b + stacked @ x),
        iterations=iterations,
        cost=cost,
        rows=len(b),
    )


def regress(problem: Problem, target: Target) -> BatchSolution:
    """Return the least squares of rows that are linear in the bodies, consistent or not.

    Undamped steps: the first finds the bodies, the next ones the biases, which enter bilinearly.
    """
    prior = SquareRootInformation.from_prior(problem.prior_mean, problem.prior_covariance)
    x, iterations, status = problem.prior_mean, 0, "NOT_CONVERGED"
    A, b = target(x)
    while status != "OK" and iterations < MAX_PLAIN_STEPS:
        iterations += 1
        information = prior.update(A, b + A @ x)
        before, x = x, information.mean()
        step = information.R @ (x - before)
        A, b = target(x)
        if step @ step < CONVERGED**2 * len(x):
            status = "OK"
    if status == "OK" and _weakest_gain(problem, A) < WEAKEST_GAIN:
        status = "INSUFFICIENT_EXCITATION"
    return BatchSolution(
        status=status,
        mean=x,
        information=prior.update(A, b + A @ x),
        iterations=iterations,
        cost=_cost(problem.prior, x, b),
        rows=len(b),
    )


def _gauss_newton(
    problem: Problem, target: RowsAt, prior: Prior, start: FloatArray
) -> tuple[FloatArray, bool]:
    """Return where undamped steps in the linear parameters settle; else the start and False.

    Far from the solution the covariance of errors-in-variables rows grows with the parameters, and
    a search by cost can prefer too heavy bodies; plain steps with re-weighting do not. Rows are
    evaluated at the nearest consistent bodies.
    """
    x = start
    for _ in range(MAX_PLAIN_STEPS):
        at = _to_x(problem, _to_theta(problem, x))
        try:
            x, moved, _ = _plain_step(target, prior, x, at)
        except (EstimatorError, np.linalg.LinAlgError):
            return start, False
        if moved < CONVERGED:
            return x, True
    return start, False


def _plain_step(
    target: RowsAt, prior: Prior, x: FloatArray, at: FloatArray
) -> tuple[FloatArray, float, SquareRootInformation]:
    """Return the minimum by rows linearised at `at`, its whitened rms step from x, information."""
    A, b = target(at)
    information = prior.at(at).update(A, b + A @ at)
    mean = information.mean()
    step = information.R @ (mean - x)
    return mean, float(np.sqrt(step @ step / len(x))), information


def _light(problem: Problem, target: RowsAt, prior: Prior, x: FloatArray) -> BatchSolution | None:
    """Return the solution where noise alone explains why a body's best values are inconsistent.

    None: the bodies are consistent, or the base is not, or noise does not explain one of them.
    """
    if all(is_consistent(x[problem.body(name)]) for name in problem.unknown):
        return None
    iterations, moved = 0, np.inf
    while moved >= CONVERGED and iterations < MAX_PLAIN_STEPS:
        iterations += 1
        try:
            x, moved, information = _plain_step(target, prior, x, x)
        except (EstimatorError, np.linalg.LinAlgError):
            return None
    if moved >= CONVERGED:
        return None
    covariance = information.covariance()
    for name in problem.unknown:
        k = problem.body(name)
        if is_consistent(x[k]):
            continue
        off = x[k] - nearest_consistent(x[k], covariance[k, k])
        far = off @ np.linalg.solve(covariance[k, k], off)
        if name == "base" or far > chdtri(len(off), NOISE_PROBABILITY):
            return None
    A, b = target(x)
    gain = _weakest_gain(problem, A)
    return BatchSolution(
        status="OK" if gain >= WEAKEST_GAIN else "INSUFFICIENT_EXCITATION",
        mean=x,
        information=information,
        iterations=iterations,
        cost=_cost(prior, x, b),
        rows=len(b),
    )


def linear_covariance(
    problem: Problem, method: str, weighting: str, solution: BatchSolution
) -> tuple[FloatArray, str]:
    """Return the covariance by the linearisation at the solution, and a note on it (may be empty).

    For torque methods and an unknown base it is mapped from the base's mobility (see `is_bent`).
    """
    covariance = solution.information.covariance()
    if weighting == "eiv" and is_bent(problem, method):
        try:
            mapped = by_mobility(solution.mean, covariance, problem.body("base"))
        except np.linalg.LinAlgError:  # singular to working precision
            return covariance, ""
        if mapped.holds and mapped.bent:
            return mapped.covariance, NOTE
    return covariance, ""


def straighten(problem: Problem, target: Target, solution: BatchSolution) -> Widening:
    """Return the solution's covariance, widened where its linearisation does not hold."""

    def profile(normal: FloatArray, value: float, start: FloatArray) -> tuple[FloatArray, float]:
        def held(x: FloatArray) -> tuple[FloatArray, FloatArray]:
            A, b = target(x)
            return np.vstack([A, STIFF * normal]), np.append(b, STIFF * (value - normal @ x))

        x = minimise(
            problem, held, start=start, max_iterations=PROFILE_ITERATIONS, plain=False
        ).mean
        return x, _cost(problem.prior, x, target(x)[1])

    return widen(
        solution.mean,
        solution.cost,
        solution.information.covariance(),
        problem.prior_covariance,
        problem.names,
        problem.bodies.stop,
        profile,
        WEAK,
    )


def _cost(prior: Prior, x: FloatArray, b: FloatArray) -> float:
    return float(b @ b) + prior.cost(x)


def _to_theta(problem: Problem, x: FloatArray) -> FloatArray:
    theta = x.copy()
    for name in problem.unknown:
        k = problem.body(name)
        pi = x[k]
        if not is_consistent(pi):
            pi = nearest_consistent(pi, problem.prior_covariance[k, k])
        theta[k] = to_log_cholesky(pi)
    return theta


def _to_x(problem: Problem, theta: FloatArray) -> FloatArray:
    x = theta.copy()
    for name in problem.unknown:
        x[problem.body(name)] = from_log_cholesky(theta[problem.body(name)])
    return x


def _chain(problem: Problem, theta: FloatArray) -> FloatArray:
    D = np.eye(len(theta))
    for name in problem.unknown:
        k = problem.body(name)
        D[k, k] = log_cholesky_jacobian(theta[k])
    return D


def _bounded(problem: Problem, step: FloatArray) -> FloatArray:
    """Limit the step so that diagonals of pseudo-inertia factors change by a factor e at most."""
    largest = max(np.abs(step[problem.body(name)][:4]).max() for name in problem.unknown)
    bounded: FloatArray = step / max(1.0, float(largest))
    return bounded


def _weakest_gain(problem: Problem, stacked: FloatArray) -> float:
    """Return the data's information over the prior's in the least known direction of the bodies.

    Nuisances are marginalised with their priors.
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
