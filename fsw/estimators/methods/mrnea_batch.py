"""MRNEA on a sample set: paper's least squares, weighted, compensated, errors in variables.

`ols` and `wls` shrink because the base acceleration's noise stands in the regressor: their sigma
includes the bias that the compensated solution reveals. `compensated` subtracts what the noise of
the accelerations adds to the normal equations; what the squared noise of the rate leaves is seen
against the errors in variables, and its sigma includes that.

`eiv` is iterated: its score X^T S^-1 r (X at the smoothed input, r at the
measured) has mean zero at the truth, but its variance G = sum X^T S^-1 X exceeds its slope G - C by
the noise C left in X; the two are combined with the prior by the Godambe information
(G - C) G^-1 (G - C) rather than by G, which would overstate what is known. Where the accelerometer
says little, it is the torques that know the base, and the covariance comes by way of its mobility.

Source: paper eqs. (8)-(16); Stefanski, Carroll, Biometrika 74 (1987), for the score;
Godambe (1960).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsw.estimators.methods.least_squares_pass import least_squares_gram
from fsw.estimators.methods.levenberg import consistent_start, cost_of, minimise
from fsw.estimators.methods.mobility_covariance import through_mobility
from fsw.estimators.methods.regression_pass import EIV, OLS, WLS, Regression, regression_pass
from fsw.estimators.methods.result import BatchResult, build_result, invert
from fsw.estimators.methods.system import Options, System, build_system, kernel_data
from fsw.estimators.model.mobility import NOTE
from fsw.estimators.model.problem import Problem
from fsw.estimators.samples import SampleSet
from fsw.messages import FloatArray
from fsw.messages.errors import EstimatorError

SETTLED = 1e-5  # squared whitened length of the last step
RISE = 1.0  # of the cost at most from its least to the root of the score, a squared sigma
COMPENSATED_NOTE = (
    "compensated for noisy accelerations, not for noisy rates; sigma is that of the errors in "
    "variables and includes the distance from them"
)
BIAS_NOTE = "shrunk by the base acceleration's noise in the regressor; sigma includes the bias"


@dataclass(frozen=True, slots=True, eq=False)
class _Pass:
    """The regression over one sample set as a function of the state."""

    samples: SampleSet
    system: System

    def __call__(self, x: FloatArray, mode: int, inflate: bool = False) -> Regression:
        system = self.system
        return regression_pass(
            system.arm,
            system.bodies(x),
            np.ascontiguousarray(x),
            system.at,
            kernel_data(self.samples, system.problem.orbit),
            system.problem.wrench_sigma,
            mode,
            inflate,
        )

    def least_squares(self, x: FloatArray) -> Regression:
        """Return the plain regression at x where bodies are the only states and inputs exact."""
        system, samples, p = self.system, self.samples, len(x)
        gram = least_squares_gram(system.arm, system.bodies(x), system.at, kernel_data(samples))
        zero = np.zeros((p, p))
        return Regression(gram / np.mean(samples.noise.tau_nm**2), zero, np.zeros(p), zero)

    def eiv_gram(self, x: FloatArray) -> FloatArray:
        """Return the Gram of the errors-in-variables rows."""
        return self(x, EIV).gram


@dataclass(frozen=True, slots=True, eq=False)
class _Consistent:
    """Solution of the errors in variables; `information` is Godambe's, of the data alone."""

    x: FloatArray
    information: FloatArray
    cost: float
    iterations: int
    converged: bool

    def covariance(self, system: System) -> FloatArray:
        """Return its covariance, NaN where it has none."""
        try:
            return invert(self.information + system.prior_information)
        except EstimatorError:
            return np.full_like(self.information, np.nan)


def solve_mrnea(samples: SampleSet, problem: Problem, options: Options) -> BatchResult:
    """Estimate from torques, joint motion and the measured base motion, `options.weighting`."""
    system = build_system(problem, options)
    run = _Pass(samples, system)
    if options.weighting == "eiv":
        return _errors_in_variables(run, options)
    return _linear(run, options)


def _linear(run: _Pass, options: Options) -> BatchResult:
    """One weighted least squares; weights and linearisation at the start, exact for the bodies."""
    system, p = run.system, len(run.system.names)
    x0 = consistent_start(system.with_bodies(options.start), system)
    mode = OLS if options.weighting == "ols" else WLS
    noisy = bool(
        np.any(run.samples.noise.a_m_s2 > 0)
        or np.any(run.samples.noise.wd_rad_s2 > 0)
        or np.any(run.samples.noise.qdd_rad_s2 > 0)
    )
    bare = p == system.problem.bodies.stop and system.problem.orbit is None
    if mode == OLS and not noisy and bare:
        raw = run.least_squares(x0)
    else:
        raw = run(x0, mode, inflate=noisy)
    plain = raw.gram[:p, :p] + system.prior_information
    pull = raw.gram[:p, p] - system.prior_information @ (x0 - system.prior_mean)
    x = x0 + _solve(plain, pull)
    compensated, singular = x, not np.all(np.isfinite(x))
    slope = plain - raw.inflation
    if noisy:
        compensated = x0 + _solve(slope, pull + raw.shrinkage)
        singular = singular or np.linalg.eigvalsh(_scaled(slope, plain))[0] <= 0
    information = raw.gram[:p, :p] - raw.inflation
    covariance, bias, note = None, None, ""
    converged = True
    if singular:
        information = np.zeros((p, p))
    elif options.weighting == "compensated":
        x = compensated
        if noisy:
            near = _consistent(run, x0, options)
            covariance, bias, note = near.covariance(system), x - near.x, COMPENSATED_NOTE
            converged = near.converged
    else:
        bias = x - compensated
        note = BIAS_NOTE if noisy else ""
        if mode == OLS and noisy:
            # the weights are not the inverse covariance: take the scores' own
            covariance = _sandwich(plain, raw.scores + system.prior_information)
    return build_result(
        system,
        options,
        method=f"mrnea-{options.weighting}",
        x=x,
        information=information,
        cost=float(raw.gram[p, p]),
        rows=(6 + run.samples.n) * len(run.samples),
        duration_s=float(run.samples.t_s[-1] - run.samples.t_s[0]),
        covariance=covariance,
        bias=bias,
        bias_note=note,
        converged=converged,
    )


def _errors_in_variables(run: _Pass, options: Options) -> BatchResult:
    """Return the consistent solution."""
    system = run.system
    start = consistent_start(system.with_bodies(options.start), system)
    found = _consistent(run, start, options)
    mapped = through_mobility(found.x, found.information, system) if found.converged else None
    bent = mapped is not None and mapped.bent
    return build_result(
        system,
        options,
        method="mrnea-eiv",
        x=found.x,
        information=found.information,
        cost=found.cost,
        rows=(6 + run.samples.n) * len(run.samples),
        duration_s=float(run.samples.t_s[-1] - run.samples.t_s[0]),
        iterations=found.iterations,
        converged=found.converged,
        covariance=mapped.covariance if mapped is not None and bent else None,
        bias_note=NOTE if bent else "",
    )


def _consistent(run: _Pass, start: FloatArray, options: Options) -> _Consistent:
    """Iterate to the root of the score, then to that of score and prior in the right proportion.

    The cost has no minimum just at the root. Where its descent stalls on the way, the steps of the
    score may still get there; they count if they settle, and not noticeably higher.
    """
    system, p = run.system, len(run.system.names)
    found = minimise(run.eiv_gram, system, start, options.max_iterations)
    x, settled = found.x, options.max_iterations == 0
    godambe = found.information
    cost = found.cost
    for _ in range(options.max_iterations if np.isfinite(cost) else 0):
        sums = run(x, EIV, inflate=True)
        G = sums.gram[:p, :p]
        slope = G - sums.inflation
        godambe, pull = _godambe(slope, G, sums.gram[:p, p])
        total = godambe + system.prior_information
        step = _solve(total, pull - system.prior_information @ (x - system.prior_mean))
        cost = cost_of(sums.gram, x, system)
        if not np.all(np.isfinite(step)):
            break
        x = x + step
        settled = bool(step @ total @ step < SETTLED)
        if settled:
            break
    if found.converged or (settled and cost <= found.cost + RISE):
        return _Consistent(x, godambe, found.cost, found.iterations, settled)
    return _Consistent(found.x, found.information, found.cost, found.iterations, False)


def _godambe(slope: FloatArray, G: FloatArray, score: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return slope G^-1 slope and slope G^-1 score; directions of no slope carry no information."""
    scale = np.sqrt(np.maximum(np.diag(G), 1e-300))
    values, vectors = np.linalg.eigh(G / np.outer(scale, scale))
    keep = values > 1e-14 * values[-1]
    root = (vectors[:, keep] / np.sqrt(values[keep])).T / scale[None, :]  # root^T root = G^-1
    # in whitened coordinates the slope is 1 - (share of noise); clip at zero information
    shares, turned = np.linalg.eigh(root @ slope @ root.T)
    shares = np.clip(shares, 0.0, 1.0)
    white = turned.T @ root
    back = np.linalg.pinv(white)
    information = back @ np.diag(shares**2) @ back.T
    pull: FloatArray = back @ (shares * (white @ score))
    return 0.5 * (information + information.T), pull


def _scaled(A: FloatArray, by: FloatArray) -> FloatArray:
    scale = np.sqrt(np.maximum(np.diag(by), 1e-300))
    scaled: FloatArray = A / np.outer(scale, scale)
    return scaled


def _solve(A: FloatArray, b: FloatArray) -> FloatArray:
    """Return A^-1 b, scaled; NaN where A is singular."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(A)), 1e-300))
    try:
        solution: FloatArray = np.linalg.solve(A / np.outer(scale, scale), b / scale) / scale
    except np.linalg.LinAlgError:
        return np.full_like(b, np.nan)
    return solution


def _sandwich(slope: FloatArray, scores: FloatArray) -> FloatArray:
    """Return slope^-1 scores slope^-T, symmetric."""
    try:
        inverse = invert(slope)
    except EstimatorError:
        return np.full_like(slope, np.nan)
    covariance = inverse @ scores @ inverse
    return 0.5 * (covariance + covariance.T)
