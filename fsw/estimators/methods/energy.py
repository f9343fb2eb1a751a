"""CE: the work-energy balance 1/2 qd^T H^(pi) qd = integral of tau^T qd dt, by intervals.

The paper's T_msr is undefined and its zero total energy ignores the motors' work (read literally it
is solved by zero masses). At zero momentum the left side is the whole kinetic energy (paper eqs.
32-33 without v_b). The balance over an interval has white noise but for the sample shared with its
neighbour, so the residuals' covariance is tridiagonal; cumulated work would be a random walk. The
rates' noise adds 1/2 tr(H^ Sigma_qd) to the energy, which is taken off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded, solve_banded

from fsw.estimators.batch.curvature import WEAK
from fsw.estimators.methods.energy_pass import Energy, energy_pass
from fsw.estimators.methods.levenberg import minimise, straighten
from fsw.estimators.methods.result import BatchResult, build_result, invert
from fsw.estimators.methods.system import Options, System, build_system, kernel_data
from fsw.estimators.model.problem import Problem, present
from fsw.estimators.samples import SampleSet
from fsw.messages import FloatArray

RATE_PASSES = 3  # the rates' noise acts through H^, known better each time
EARLY_DECREMENT = 1e-1  # of the first approach, held by the prior's width around the start
FLOOR = 1e-6  # of the mean variance: an arm at rest does no work and has no noise


@dataclass(frozen=True, slots=True, eq=False)
class _Balance:
    """Work and its noise over intervals of `size` samples, ends at the shared samples."""

    samples: SampleSet
    system: System
    ends: slice  # of the samples
    work: FloatArray  # (K,)
    columns: FloatArray  # (K, p) of torque offset and scale
    variance: FloatArray  # (K,)
    shared: FloatArray  # (K-1,) covariance of neighbours
    index: NDArray[np.intp]  # (K, size+1) samples of each interval
    weights: FloatArray  # (size+1,) of Simpson's rule [s]

    def energy(self, x: FloatArray, part: slice | None = None) -> Energy:
        """Return the kinetic energy at the intervals' ends, or at a part of the samples."""
        samples, system = self.samples, self.system
        part = self.ends if part is None else part
        q, qd = np.ascontiguousarray(samples.q[part]), np.ascontiguousarray(samples.qd[part])
        field = np.ascontiguousarray(kernel_data(samples, system.problem.orbit).field[part])
        return energy_pass(system.arm, system.bodies(x), len(x), system.at, q, qd, field)

    def heeding_rates(self, x: FloatArray) -> _Balance:
        """Return the balance with what the rates' noise does, evaluated at x."""
        sigma = self.samples.noise.qd_rad_s
        if sigma is None:
            return self
        energy = self.energy(x)
        own = energy.momentum**2 @ sigma**2
        return replace(
            self,
            work=self.work + np.diff(0.5 * energy.diagonal @ sigma**2),
            variance=self.variance + own[1:] + own[:-1],
            shared=self.shared - own[1:-1],
        )

    def gram(self, x: FloatArray) -> FloatArray:
        """Return the Gram (p+1, p+1) of the whitened rows at x."""
        system, p = self.system, len(x)
        energy = self.energy(x)
        T, variance, shared = energy.T, self.variance, self.shared
        rows = np.empty((len(self.work), p + 1))
        rows[:, :p] = np.diff(energy.J, axis=0) + self.columns
        predicted = np.diff(T)
        problem = system.problem
        for states in (problem.torque_offset, problem.torque_scale):
            if present(states):
                predicted = predicted + self.columns[:, states] @ x[states]
        rows[:, p] = self.work - predicted
        if problem.orbit is not None:
            whole = self.energy(x, slice(None))
            rows[:, p] += whole.P[self.index] @ self.weights
            rows[:, :p] -= np.einsum("w,kwp->kp", self.weights, whole.J_P[self.index])
        band = np.zeros((2, len(variance)))
        band[0] = variance + FLOOR * variance.mean()
        band[1, :-1] = shared
        white = solve_banded((1, 0), cholesky_banded(band, lower=True), rows)
        G: FloatArray = white.T @ white
        return G


def solve_energy(samples: SampleSet, problem: Problem, options: Options) -> BatchResult:
    """Estimate from joint torques and rates alone."""
    system = build_system(problem, options)
    balance = _build(samples, system, options.energy_interval)
    start = system.with_bodies(options.start)
    gram = balance.heeding_rates(start).gram
    held = replace(system, prior_mean=start, prior_information=invert(system.prior_covariance))
    near = minimise(gram, held, start, options.max_iterations, EARLY_DECREMENT)  # a start far off
    start = near.x if np.isfinite(near.cost) else start
    found = minimise(gram, system, start, options.max_iterations)
    for _ in range(RATE_PASSES if samples.noise.qd_rad_s is not None else 0):
        gram = balance.heeding_rates(found.x).gram
        found = minimise(gram, system, found.x, options.max_iterations)
    looked = straighten(gram, system, found, WEAK) if options.max_iterations > 0 else None
    return build_result(
        system,
        options,
        method="ce",
        x=found.x,
        information=found.information,
        cost=found.cost,
        rows=len(balance.work),
        duration_s=float(samples.t_s[-1] - samples.t_s[0]),
        iterations=near.iterations + found.iterations,
        converged=found.converged,
        widening=looked,
    )


def _build(samples: SampleSet, system: System, size: int) -> _Balance:
    """Integrate power by Simpson's rule over intervals of `size` (even) samples."""
    if size < 2 or size % 2:
        raise ValueError(f"energy_interval {size} must be even and at least 2")
    K = (len(samples) - 1) // size
    if K < 2:
        raise ValueError(f"{len(samples)} samples hold fewer than two intervals of {size}")
    dt = float(samples.t_s[-1] - samples.t_s[0]) / (len(samples) - 1)
    weights = np.full(size + 1, 2.0)
    weights[1::2] = 4.0
    weights[0] = weights[-1] = 1.0
    weights *= dt / 3.0
    index = size * np.arange(K)[:, None] + np.arange(size + 1)
    power = np.einsum("ij,ij->i", samples.tau, samples.qd)
    noise = samples.qd**2 @ samples.noise.tau_nm**2
    if samples.noise.qd_rad_s is not None:
        noise = noise + samples.tau**2 @ samples.noise.qd_rad_s**2
    columns = np.zeros((K, len(system.names)))
    problem = system.problem
    if present(problem.torque_offset):
        columns[:, problem.torque_offset] = np.einsum("w,kwj->kj", weights, samples.qd[index])
    if present(problem.torque_scale):
        product = samples.qd * samples.tau
        columns[:, problem.torque_scale] = np.einsum("w,kwj->kj", weights, product[index])
    ends = slice(0, K * size + 1, size)
    return _Balance(
        samples,
        system,
        ends,
        power[index] @ weights,
        columns,
        noise[index] @ weights**2,
        weights[0] * weights[-1] * noise[ends][1:-1],
        index,
        weights,
    )
