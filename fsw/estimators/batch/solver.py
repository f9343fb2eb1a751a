"""Batch identification of stored blocks by any method: damped Gauss-Newton over consistent bodies.

The unknown bodies are iterated in log-Cholesky coordinates, so every iterate is physically possible
and the base's inertia never becomes singular; the covariance is given in the linear parameters.
"""

from collections.abc import Callable, Sequence
from itertools import compress, pairwise

import numpy as np
from scipy.special import chdtri

from fsw.estimators.batch.curvature import STIFF, WEAK, Widening, widen
from fsw.estimators.batch.plain import (
    CONVERGED,
    MAX_PLAIN_STEPS,
    NOISE_PROBABILITY,
    PATIENCE,
    WEAKEST_GAIN,
    BatchSolution,
    RowsAt,
    cost_of,
    plain_solution,
    to_theta,
    to_x,
    weakest_gain,
)
from fsw.estimators.measurement.row_functions import Linearisation, RowsFunction
from fsw.estimators.model.inertia import log_cholesky_jacobian
from fsw.estimators.model.mobility import NOTE, by_mobility, is_bent
from fsw.estimators.model.prior import Prior
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.state_groups import in_words
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import Block, FloatArray

MAX_ITERATIONS = 60
USUAL_PASSES = 10  # within which most batches converge, for the share that is reported
PROFILE_ITERATIONS = 4  # of every point of a profile
NEGLIGIBLE = 1e-6  # whitened rms step after which the rows are not evaluated again
DAMPING = 1e-3  # initial

Progress = Callable[[float, str], bool]  # fraction and text; False aborts


class Target:
    """Cost of a batch: whitened rows of some blocks at a state, scaled to a noise level.

    Parameters
    ----------
    linear : rows of all blocks
    fits : which blocks count; None: all
    level : ratio of the noise's variance to the declared one
    """

    def __init__(
        self, linear: Linearisation, fits: Sequence[bool] | None = None, level: float = 1.0
    ) -> None:
        self._linear, self._fits, self._weight = linear, fits, level**-0.5

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return A (k, p) and b (k,) of all rows; of a long linearisation `reduced` ones."""
        first, found = 0, list[tuple[FloatArray, FloatArray]]()
        for part in self._linear.parts(x, self._fits):
            fits = None if self._fits is None else self._fits[first : first + len(part)]
            first += len(part)
            used = part if fits is None else list(compress(part, fits))
            if used:
                found.append((np.vstack([r.A for r in used]), np.concatenate([r.b for r in used])))
            if len(found) > 1:
                found = [reduced(*found)]
        ((A, b),) = found
        return (A, b) if self._weight == 1.0 else (self._weight * A, self._weight * b)


def reduced(*rows: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Join pairs A (m, p), b (m,) of rows into one pair of at most p + 1 rows.

    A^T A, A^T b and b^T b stay the same, because the rows are rotated only.
    """
    stacked = np.vstack([np.column_stack(own) for own in rows])
    R = np.asarray(np.linalg.qr(stacked, mode="r"), np.float64)
    return R[:, :-1], R[:, -1]


def solve(
    problem: Problem,
    rows: RowsFunction,
    blocks: Sequence[Block],
    progress: Progress | None = None,
    start: FloatArray | None = None,
) -> BatchSolution:
    """Minimise over the rows of some blocks; see `minimise`."""
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

    The best values of a light body, such as an empty gripper, often lie just outside the consistent
    ones. If noise alone explains this, they are the solution, and the published body is marked as
    inconsistent. If noise does not, the least cost lies at the edge of the consistent bodies, which
    is infinitely far in log-Cholesky coordinates. Gauss-Newton steps to the nearest consistent
    bodies find it, and the note says what the data want instead.

    Parameters
    ----------
    progress : receives fraction and text of each iteration; False aborts; None: no reports
    start : (p,) first iterate, moved to consistent bodies if needed; None: the prior's mean
    plain : whether re-weighted Gauss-Newton comes first. Levenberg-Marquardt over the consistent
        bodies then begins where Gauss-Newton settled, otherwise at the start.
    """
    prior = problem.prior
    x = prior.mean if start is None else start
    if plain:
        x, found = plain_solution(problem, target, prior, x)
        if found is not None:
            return found
    return _damped(problem, target, prior, x, progress, max_iterations)


def _damped(
    problem: Problem,
    target: RowsAt,
    prior: Prior,
    x: FloatArray,
    progress: Progress | None,
    max_iterations: int,
) -> BatchSolution:
    """Return the end of Levenberg-Marquardt over the consistent bodies, from x (p,).

    It ends early, not converged, if steps at their present rate do not settle in the passes left,
    and the prior's cost at the present gain does not fall to what the declared doubts explain.
    """
    theta = to_theta(problem, x)
    x = to_x(problem, theta)
    damping, iterations, status, before = DAMPING, 0, "NOT_CONVERGED", x
    away, crawl = list[str](), _Crawl(problem, prior, max_iterations)
    stacked, b = target(x)
    cost = cost_of(prior, x, b)
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
            trial = to_x(problem, trial_theta)
            try:
                trial_stacked, trial_b = target(trial)
                trial_cost = cost_of(prior, trial, trial_b)
            except np.linalg.LinAlgError:  # so far off that nothing can be predicted
                trial_cost = np.inf
            accepted = trial_cost <= cost * (1 + 1e-9)
            damping = max(damping / 10, 1e-12) if accepted else damping * 10
        if not accepted:
            break
        gained, before = cost - trial_cost, x
        theta, x, stacked, b, cost = trial_theta, trial, trial_stacked, trial_b, trial_cost
        words = (
            f"solving, pass {iterations} of at most {max_iterations}: the estimate still moves by "
        )
        words += f"{moved:.2g} of its uncertainty"
        if progress is not None and not progress(min(1.0, iterations / USUAL_PASSES), words):
            status = "ABORTED"
            break
        # a step that is cut short and gains nothing: the least cost is infinitely far away
        away = _runs_away(problem, step) if gained < CONVERGED**2 * len(x) else []
        if moved < CONVERGED or away:
            status = "OK"
            break
        if crawl.is_hopeless(x, step, moved, gained):
            break
    if status == "OK" and weakest_gain(problem, stacked) < WEAKEST_GAIN:
        status = "INSUFFICIENT_EXCITATION"
    information = prior.at(x).update(stacked, b + stacked @ x)
    return BatchSolution(
        status=status,
        mean=x,
        information=information,
        iterations=iterations,
        cost=cost,
        note=_note(problem, away, status, x - before, information),
    )


def _note(
    problem: Problem,
    away: Sequence[str],
    status: str,
    step: FloatArray,
    information: SquareRootInformation,
) -> str:
    if status == "NOT_CONVERGED":
        return _still_moving(problem, step, information)
    return "; ".join(f"the data want no body at all for the {name}" for name in away)


def _still_moving(problem: Problem, step: FloatArray, information: SquareRootInformation) -> str:
    """Return a note on the state that the last step changed most in its own sigmas."""
    sigma = np.sqrt(np.diag(information.covariance()))
    sigmas = np.abs(step) / sigma
    most = int(np.argmax(sigmas))
    if not sigmas[most] > 0.0:
        return "no step makes the residuals smaller"
    return (
        f"{in_words(problem.names[most])} still moves by {sigmas[most]:.2g} sigma at each step: "
        "the motion hardly shows it, or the data contradict it; ask fsw check CONFIG RECORDING"
    )


def regress(problem: Problem, target: Target) -> BatchSolution:
    """Return the least-squares solution of rows that are linear in the bodies, consistent or not.

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
    if status == "OK" and weakest_gain(problem, A) < WEAKEST_GAIN:
        status = "INSUFFICIENT_EXCITATION"
    return BatchSolution(
        status=status,
        mean=x,
        information=prior.update(A, b + A @ x),
        iterations=iterations,
        cost=cost_of(problem.prior, x, b),
    )


def linear_covariance(
    problem: Problem,
    method: str,
    weighting: str,
    solution: BatchSolution,
    covariance: FloatArray | None = None,
) -> tuple[FloatArray, str]:
    """Return the covariance by the linearisation at the solution, and a note on it (may be empty).

    `covariance` (p, p) is that of the linear parameters; None: the inverse of the solution's
    information. For torque methods and an unknown base it is mapped from the base's mobility (see
    `is_bent`).
    """
    if covariance is None:
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
    """Return the solution's covariance (p, p), widened where the cost is not a parabola.

    Along the weakest axes the cost is minimised with the axis held (its profile).
    """

    def profile(normal: FloatArray, value: float, start: FloatArray) -> tuple[FloatArray, float]:
        def held(x: FloatArray) -> tuple[FloatArray, FloatArray]:
            A, b = target(x)
            return np.vstack([A, STIFF * normal]), np.append(b, STIFF * (value - normal @ x))

        x = minimise(
            problem, held, start=start, max_iterations=PROFILE_ITERATIONS, plain=False
        ).mean
        return x, cost_of(problem.prior, x, target(x)[1])

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


def _chain(problem: Problem, theta: FloatArray) -> FloatArray:
    D = np.eye(len(theta))
    for name in problem.unknown:
        k = problem.body(name)
        D[k, k] = log_cholesky_jacobian(theta[k])
    return D


def _bounded(problem: Problem, step: FloatArray) -> FloatArray:
    """Limit the step so that diagonals of pseudo-inertia factors change by a factor e at most."""
    largest = max(_log_factor(problem, step, name) for name in problem.unknown)
    bounded: FloatArray = step / max(1.0, float(largest))
    return bounded


class _Crawl:
    """Steps so far, to tell a search that cannot end well."""

    def __init__(self, problem: Problem, prior: Prior, most: int) -> None:
        self._problem, self._prior, self._left = problem, prior, most
        self._lengths: list[float] = []

    def is_hopeless(self, x: FloatArray, step: FloatArray, moved: float, gained: float) -> bool:
        """Add a step to x (p,); return whether steps do not settle, far from what doubts explain.

        Steps near a least cost shrink by one factor each (Dennis, Schnabel, Numerical Methods
        (1983), 2.3); the best factor of late is taken for all passes left, and so is the last gain
        for the prior's cost. With fewer than PATIENCE passes left there is little to save.
        """
        self._left -= 1
        self._lengths = [] if _runs_away(self._problem, step) else [*self._lengths, moved]
        if len(self._lengths) <= PATIENCE or self._left < PATIENCE:
            return False
        last = self._lengths[-PATIENCE - 1 :]
        rate = min(1.0, *(after / before for before, after in pairwise(last)))
        strain = self._prior.cost(x) - self._left * gained
        explained = float(chdtri(len(x), NOISE_PROBABILITY))
        return moved * rate**self._left >= CONVERGED and strain > explained


def _runs_away(problem: Problem, step: FloatArray) -> list[str]:
    """Return the bodies of which `_bounded` shortens the step."""
    return [name for name in problem.unknown if _log_factor(problem, step, name) > 1.0]


def _log_factor(problem: Problem, step: FloatArray, name: str) -> float:
    """Return the largest change of the logarithm of a diagonal of a body's factor."""
    return float(np.abs(step[problem.body(name)][:4]).max())
