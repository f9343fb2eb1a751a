"""Compare the predicted scatter with that of noisy samples through the flight estimator."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from evidence.excitation import cases
from evidence.methods.sensed import ChannelNoise, condition, draws, sensed, with_biases, with_noise
from fsw.estimators.batch.solver import solve
from fsw.estimators.measurement.row_functions import row_function
from fsw.estimators.model.inertia import is_consistent
from fsw.estimators.model.problem import Problem
from hil.world.inertia import FloatArray
from hil.world.truth import simulate
from planner import criteria
from planner.assess import information_root
from planner.spline import Trajectory

CONFIDENCE = 0.99
NOISE = ChannelNoise(
    position_rad=cases.POSITION_NOISE_RAD,
    torque_nm=cases.TORQUE_NOISE_NM,
    rate_rad_s=cases.RATE_NOISE * cases.RATE_HZ**0.5,
    acceleration_m_s2=cases.FORCE_NOISE * cases.RATE_HZ**0.5,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scatter:
    """Errors of the runs in units of the predicted covariance."""

    names: tuple[str, ...]  # of the parameters
    runs: int
    pooled_ratio: float  # rms of the errors of all parameters, whitened by the prediction
    chi_square: FloatArray  # (p,) sum over the runs of (error / predicted sigma)^2
    interval: tuple[float, float]  # chi-square interval of one parameter's sum
    not_converged: int  # runs

    @property
    def outside(self) -> list[str]:
        """The names of the parameters whose sum is outside the interval."""
        low, high = self.interval
        pairs = zip(self.names, self.chi_square, strict=True)
        return [name for name, value in pairs if not low <= value <= high]


def scatter(
    system: str,
    trajectory: Trajectory,
    runs: int,
    seed: int = 0,
    say: Callable[[str], None] = lambda _text: None,
) -> Scatter:
    """Simulate `runs` flights of one trajectory and estimate the unknown bodies in each flight.

    Noise, biases, offsets and prior mean are drawn for each run, from the distributions that the
    configuration declares.
    """
    own = cases.subject(system)
    problem, p = own.problem, len(own.x)
    spline = cases.joint_spline(trajectory)
    history = simulate(cases.truth(system), spline, 0.0, spline.duration_s + 0.01, 0.005)
    count = int(spline.duration_s * cases.RATE_HZ)
    exact = sensed(history.at((np.arange(count) + 0.5) / cases.RATE_HZ), own.config)
    C = criteria.covariance(information_root(own, trajectory, 5.0), p)[:p]
    L = np.linalg.cholesky(0.5 * (C + C.T))
    sigma = np.sqrt(np.diag(C))
    errors, failed = np.empty((runs, p)), 0
    for run in range(runs):
        rng = np.random.default_rng([seed, run])
        unit = draws(count, cases.JOINTS, rng, shared=False)
        noisy = with_biases(with_noise(exact, NOISE, unit), own.config, rng)
        kept = condition(noisy, own.config, cases.RATE_HZ)
        drawn = replace(problem, prior_mean=_drawn_prior(problem, own.x, rng))
        start = drawn.prior_mean.copy()
        start[:p] = own.x
        found = solve(drawn, row_function("fused", "eiv", drawn), kept, start=start)
        failed += found.status != "OK"
        errors[run] = found.mean[:p] - own.x
        if run % 10 == 9:
            white = np.linalg.solve(L, errors[: run + 1].T)
            say(f"{system}: {run + 1} runs, pooled ratio {np.sqrt(np.mean(white**2)):.4f}")
    white = np.linalg.solve(L, errors.T)
    tail = 0.5 * (1 - CONFIDENCE)
    return Scatter(
        names=problem.names[:p],
        runs=runs,
        pooled_ratio=float(np.sqrt(np.mean(white**2))),
        chi_square=np.sum((errors / sigma) ** 2, axis=0),
        interval=(float(chi2.ppf(tail, runs)), float(chi2.ppf(1 - tail, runs))),
        not_converged=failed,
    )


def _drawn_prior(problem: Problem, truth: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return a prior mean drawn about the true bodies; the biases keep the mean zero."""
    L = np.linalg.cholesky(problem.prior_covariance[problem.bodies, problem.bodies])
    mean = problem.prior_mean.copy()
    for _ in range(10_000):
        drawn = truth + L @ rng.standard_normal(len(truth))
        if all(is_consistent(drawn[problem.body(name)]) for name in problem.unknown):
            mean[problem.bodies] = drawn
            break
    return mean
