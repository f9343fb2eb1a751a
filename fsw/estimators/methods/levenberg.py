"""Levenberg-Marquardt over physically consistent bodies, on Gram matrices.

One pass over all samples gives cost, gradient and information at a point; everything else is small.
Bodies move in log-Cholesky coordinates, so every point visited is physically consistent; the
coordinates are rescaled by the information's diagonal. Source: Nocedal, Wright (2006), sec. 10.3,
with Nielsen's damping (1999); Rucker, Wensing (2022) for the coordinates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fsw.estimators.batch.curvature import Widening, constrained_prior, widen
from fsw.estimators.methods.result import invert
from fsw.estimators.methods.system import System
from fsw.estimators.model.inertia import (
    PARAMETERS,
    from_log_cholesky,
    is_consistent,
    log_cholesky_jacobian,
    nearest_consistent,
    to_log_cholesky,
)
from fsw.messages import FloatArray
from fsw.messages.errors import EstimatorError

Gram = Callable[[FloatArray], FloatArray]  # x -> (p+1, p+1) of [J | r]

DECREMENT = 1e-5  # squared whitened length of the Gauss-Newton step at which it has converged
MAX_DAMPING = 1e12
SETTLE_STEPS = 20
PROFILE_ITERATIONS = 10
PROFILE_DECREMENT = 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """Where the iteration ended. `information` is the data's own, without the prior."""

    x: FloatArray
    information: FloatArray
    gradient: FloatArray  # of the data: J^T r
    cost: float  # squared whitened residuals plus the prior's
    iterations: int
    converged: bool


def minimise(
    gram: Gram,
    system: System,
    start: FloatArray,
    max_iterations: int,
    decrement: float = DECREMENT,
) -> Minimum:
    """Minimise the squared residuals and the prior from a start; its bodies are made consistent."""
    p = len(start)
    coordinates = _to_coordinates(start, system)
    x = _from_coordinates(coordinates, system)
    G = gram(x)
    cost = cost_of(G, x, system)
    damping, growth = 1e-3, 2.0
    converged = False
    iterations = 0
    while iterations < max_iterations and np.isfinite(cost):
        iterations += 1
        T = _jacobian(coordinates, system)
        gradient = T.T @ (G[:p, p] - system.prior_information @ (x - system.prior_mean))
        A = T.T @ (G[:p, :p] + system.prior_information) @ T
        scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
        A, gradient = A / np.outer(scale, scale), gradient / scale
        if gradient @ _solve(A, gradient, 1e-12) < decrement:
            converged = True
            break
        accepted = False
        while damping < MAX_DAMPING and not accepted:
            step = _bounded(_solve(A, gradient, damping), scale, system)
            gain = step @ (2.0 * gradient - A @ step)
            trial = coordinates + step / scale
            trial_x = _from_coordinates(trial, system)
            trial_G = gram(trial_x) if np.all(np.isfinite(trial_x)) else np.full_like(G, np.nan)
            trial_cost = cost_of(trial_G, trial_x, system)
            ratio = (cost - trial_cost) / gain
            accepted = bool(np.isfinite(trial_cost) and ratio > 1e-4)
            if not accepted:
                damping, growth = damping * growth, 2.0 * growth
        if not accepted:
            at = (x, G, cost)
            x, G, cost, converged = _settle(gram, system, coordinates, at, decrement)
            break
        damping *= max(0.1, 1.0 - (2.0 * ratio - 1.0) ** 3)
        growth = 2.0
        coordinates, x, G, cost = trial, trial_x, trial_G, trial_cost
    return Minimum(x, G[:p, :p], G[:p, p], cost, iterations, converged)


def _bounded(step: FloatArray, scale: FloatArray, system: System) -> FloatArray:
    """Return the scaled step, shortened so that no diagonal of a factor changes by more than e.

    At the edge of the possible bodies the logarithms have no gradient: a leap there never returns.
    """
    largest = max(
        np.abs(step[k.start : k.start + 4] / scale[k.start : k.start + 4]).max()
        for k in map(system.problem.body, system.problem.unknown)
    )
    bounded: FloatArray = step / max(1.0, float(largest))
    return bounded


def _settle(
    gram: Gram,
    system: System,
    coordinates: FloatArray,
    at: tuple[FloatArray, FloatArray, float],
    decrement: float,
) -> tuple[FloatArray, FloatArray, float, bool]:
    """Return x, Gram, cost at the root of the score, or the start if it is not reached, and if so.

    A score that is centred for the squared noise of its inputs is not quite the cost's gradient, so
    the last fraction of a sigma may cost a little; undamped steps are taken while they shrink. When
    they stall nothing was found, and the point of least cost stands.
    """
    x, G, cost = at
    p = len(x)
    last = np.inf
    for _ in range(SETTLE_STEPS):
        T = _jacobian(coordinates, system)
        gradient = T.T @ (G[:p, p] - system.prior_information @ (x - system.prior_mean))
        A = T.T @ (G[:p, :p] + system.prior_information) @ T
        scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
        step = _solve(A / np.outer(scale, scale), gradient / scale, 1e-12)
        length = float(step @ (gradient / scale))
        if length < decrement:
            return x, G, cost, True
        if not length < 0.9 * last:
            break
        last = length
        trial = coordinates + step / scale
        trial_x = _from_coordinates(trial, system)
        if not np.all(np.isfinite(trial_x)):
            break
        trial_G = gram(trial_x)
        trial_cost = cost_of(trial_G, trial_x, system)
        if not np.isfinite(trial_cost):
            break
        coordinates, x, G, cost = trial, trial_x, trial_G, trial_cost
    return *at, False


def straighten(gram: Gram, system: System, found: Minimum, weak: float) -> Widening | None:
    """Return the covariance widened where the linearisation fails; None if it has none at all."""

    def profile(normal: FloatArray, value: float, start: FloatArray) -> tuple[FloatArray, float]:
        mean, information = constrained_prior(
            system.prior_mean, system.prior_information, normal, value
        )
        held = replace(system, prior_mean=mean, prior_information=information)
        x = minimise(gram, held, start, PROFILE_ITERATIONS, PROFILE_DECREMENT).x
        return x, cost_of(gram(x), x, system)

    try:
        covariance = invert(found.information + system.prior_information)
    except EstimatorError:
        return None
    prior = system.prior_covariance
    bodies = system.problem.bodies.stop
    return widen(found.x, found.cost, covariance, prior, system.names, bodies, profile, weak)


def _solve(A: FloatArray, g: FloatArray, damping: float) -> FloatArray:
    """Return (A + damping 1)^-1 g for a unit-diagonal A, by its eigenvalues: A may be singular."""
    values, vectors = np.linalg.eigh(A)
    solution: FloatArray = vectors @ ((vectors.T @ g) / (np.maximum(values, 0.0) + damping))
    return solution


def cost_of(G: FloatArray, x: FloatArray, system: System) -> float:
    """Return squared residuals plus the prior's at x of the Gram matrix [J | r] there."""
    off = x - system.prior_mean
    return float(G[-1, -1] + off @ system.prior_information @ off)


def _to_coordinates(x: FloatArray, system: System) -> FloatArray:
    coordinates = x.copy()
    problem = system.problem
    for name in problem.unknown:
        k = problem.body(name)
        pi = x[k]
        if not is_consistent(pi):
            pi = nearest_consistent(pi, system.prior_covariance[k, k])
        try:
            coordinates[k] = to_log_cholesky(pi)
        except np.linalg.LinAlgError:  # on the boundary within rounding
            coordinates[k] = to_log_cholesky(system.prior_mean[k])
    return coordinates


def _from_coordinates(coordinates: FloatArray, system: System) -> FloatArray:
    x = coordinates.copy()
    for name in system.problem.unknown:
        k = system.problem.body(name)
        logs = slice(k.start, k.start + 4)
        if np.any(np.abs(coordinates[logs]) > 100.0):
            return np.full_like(x, np.nan)
        x[k] = from_log_cholesky(coordinates[k])
    return x


def _jacobian(coordinates: FloatArray, system: System) -> FloatArray:
    T = np.eye(len(coordinates))
    for name in system.problem.unknown:
        k = system.problem.body(name)
        T[k, k] = log_cholesky_jacobian(coordinates[k])
    return T


def consistent_start(x: FloatArray, system: System) -> FloatArray:
    """Return x with every body moved to the nearest consistent one in the prior's metric."""
    result = x.copy()
    for index in range(len(system.problem.unknown)):
        k = slice(PARAMETERS * index, PARAMETERS * (index + 1))
        if not is_consistent(x[k]):
            result[k] = nearest_consistent(x[k], system.prior_covariance[k, k])
    return result
