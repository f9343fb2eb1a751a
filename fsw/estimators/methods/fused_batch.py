"""Maximum likelihood over torque, accelerometer and gyro, and its projections.

RDA (paper eqs. 22-27) is the torque channel at the measured base rate, without base acceleration
and without v_b; CM (eqs. 30-31) the gyro channel, in the study with the base velocity too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fsw.estimators.batch.curvature import VERY_WEAK, WEAK
from fsw.estimators.methods.layout import Channels
from fsw.estimators.methods.levenberg import minimise, straighten
from fsw.estimators.methods.mobility_covariance import through_mobility
from fsw.estimators.methods.motion import refine
from fsw.estimators.methods.prediction_pass import prediction_pass
from fsw.estimators.methods.rate_pass import Known, known_pass, rate_pass
from fsw.estimators.methods.result import BatchResult, build_result, invert
from fsw.estimators.methods.system import Options, System, build_system, kernel_data
from fsw.estimators.model.mobility import NOTE
from fsw.estimators.model.problem import Problem
from fsw.estimators.samples import SampleSet
from fsw.messages import FloatArray

FUSED = Channels(torque=True, accelerometer=True, gyro=True, velocity=False, measured_rate=False)
EARLY_SAMPLES = 300  # spread over the set, for the first approach; all samples enter after it
EARLY_DECREMENT = 1e-1
EARLY_FROM = 4 * EARLY_SAMPLES


def solve_fused(
    samples: SampleSet, problem: Problem, options: Options, use: Channels = FUSED
) -> BatchResult:
    """Estimate from all channels at once: the most the data allows."""
    return solve_channels(samples, problem, options, use, "fused")


def solve_channels(
    samples: SampleSet, problem: Problem, options: Options, use: Channels, method: str
) -> BatchResult:
    """Minimise the whitened residuals of the chosen channels over consistent bodies.

    A start far off is first brought close on an even subset of the samples, held by the prior's
    width around the start; the solution over all of them then replaces it.
    """
    system = build_system(problem, options)
    start = system.with_bodies(options.start)
    iterations = 0
    stride = len(samples) // EARLY_SAMPLES
    if len(samples) >= EARLY_FROM and system.at.wrench < 0:
        early = samples.take(slice(stride // 2, None, stride))
        held = replace(system, prior_mean=start, prior_information=invert(system.prior_covariance))
        first = minimise(
            _Pass(early, held, use), held, start, options.max_iterations, EARLY_DECREMENT
        )
        iterations += first.iterations
        start = first.x if np.isfinite(first.cost) else start
    run = _Pass(samples, system, use)
    found = minimise(run, system, start, options.max_iterations)
    curve = samples.curve if use.gyro and use.torque else None
    if curve is not None and np.all(np.isfinite(found.x)):
        found = refine(samples, curve, system, use, found.x, options.max_iterations)
    mapped = None
    if use.torque and found.converged:
        mapped = through_mobility(found.x, found.information, system)
    looked = None
    if mapped is None and curve is None and options.max_iterations > 0:
        looked = straighten(run, system, found, VERY_WEAK if use.torque else WEAK)
    width = problem.model.n * use.torque + 3 * (use.accelerometer + use.gyro + use.velocity)
    return build_result(
        system,
        options,
        method=method,
        x=found.x,
        information=found.information,
        cost=found.cost,
        rows=width * len(samples),
        duration_s=float(samples.t_s[-1] - samples.t_s[0]),
        iterations=iterations + found.iterations,
        converged=found.converged,
        covariance=mapped.covariance if mapped is not None and mapped.bent else None,
        bias_note=NOTE if mapped is not None and mapped.bent else "",
        widening=looked,
    )


class _Pass:
    """The pass over one sample set as a function of the state."""

    def __init__(self, samples: SampleSet, system: System, use: Channels) -> None:
        data = kernel_data(samples, system.problem.orbit)
        self._data, self._system, self._use = data, system, use
        self._known: Known | None = None
        if not (use.torque or use.accelerometer or system.problem.orbit):
            nothing = np.zeros_like(system.prior_mean)
            self._known = known_pass(system.arm, system.bodies(nothing), data)

    def __call__(self, x: FloatArray) -> FloatArray:
        system, data, use = self._system, self._data, self._use
        x = np.ascontiguousarray(x)
        if self._known is not None:
            return rate_pass(self._known, x, system.at, data, use)
        return prediction_pass(system.arm, system.bodies(x), x, system.at, data, use)
