"""One unit of the study: the methods on its samples, judged by the end-effector error."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from fsw.estimators.methods.energy import solve_energy
from fsw.estimators.methods.fused_batch import solve_fused
from fsw.estimators.methods.momentum import solve_momentum
from fsw.estimators.methods.mrnea_batch import solve_mrnea
from fsw.estimators.methods.rda import solve_rda
from fsw.estimators.methods.result import BatchResult
from fsw.estimators.methods.system import Options
from fsw.estimators.model.problem import Problem
from fsw.estimators.samples import SampleSet
from fsw.messages.errors import EstimatorError
from hil.evidence.methods.flight_side import problem_of, write_config
from hil.evidence.paper.cases import Unit, exact_sensors, noise_of, scenario_of, truth_of
from hil.evidence.paper.samples import noisy_samples
from hil.judge.endeffector import Verification
from hil.judge.floating import FloatingRobot
from hil.judge.score import normalised_error_squared
from hil.world.inertia import FloatArray, pi_of, report_of
from hil.world.spline import JointSpline

NO_PRIOR = Options(body_prior=False)
WRENCH = {"external_force_sigma_n": 0.01, "external_torque_sigma_nm": 0.02}
DRAWS = 200
DRAW_STREAM = 137


def run_samples(unit: Unit, rate_hz: float) -> dict[str, Any]:
    """Return every method's result on one draw of noise, plain values."""
    samples = noisy_samples(
        unit.orbit, unit.system, unit.acting, noise_of(unit.noise, rate_hz), rate_hz, unit.seed
    )
    plain = problem(unit.orbit, unit.system, unit.acting, unit.seed, with_wrench=False)
    found: dict[str, Any] = {}
    for method in unit.methods:
        try:
            if method == "fused":
                found[method] = _fused(unit, samples, plain)
            else:
                found[method] = judged(unit, PAPER_METHODS[method](samples, plain))
        except (EstimatorError, np.linalg.LinAlgError) as error:
            found[method] = {"status": f"FAILED: {error}"}
    return found


def problem(orbit: str, system: str, acting: str, seed: int, *, with_wrench: bool) -> Problem:
    """Return what the flight side is to estimate, its prior drawn from the seed.

    Of the environment it knows the gravity gradient, as in the paper; samples count from the start
    of the motion.
    """
    scenario = scenario_of(orbit, system, acting)
    told = replace(exact_sensors(scenario, WRENCH if with_wrench else {}), before_s=0.0)
    with tempfile.TemporaryDirectory(prefix="study-") as folder:
        return problem_of(write_config(told, seed, Path(folder)))


def _fused(unit: Unit, samples: SampleSet, plain: Problem) -> dict[str, Any]:
    """All channels; where something acts from outside, a constant wrench is estimated along."""
    bare = replace(samples, v_NB_B=None)
    result = solve_fused(bare, plain, NO_PRIOR)
    if unit.acting != "none":
        pulled = problem(unit.orbit, unit.system, unit.acting, unit.seed, with_wrench=True)
        start = pulled.prior_mean.copy()
        start[pulled.bodies] = result.mean[plain.bodies]
        result = solve_fused(bare, pulled, replace(NO_PRIOR, start=start))
    return judged(unit, result)


def _mrnea(samples: SampleSet, plain: Problem) -> BatchResult:
    """Eqs. 5 to 16: ordinary least squares with the measured base acceleration."""
    return solve_mrnea(samples, plain, replace(NO_PRIOR, weighting="ols"))


def _rda(samples: SampleSet, plain: Problem) -> BatchResult:
    """Eq. 27: unweighted torque residuals; motion taken as exact."""
    exact = replace(
        samples.noise, qdd_rad_s2=np.zeros(samples.n), w_rad_s=np.zeros(3), v_m_s=np.zeros(3)
    )
    return solve_rda(replace(samples, v_NB_B=None, noise=exact), plain, NO_PRIOR)


def _cm(samples: SampleSet, plain: Problem) -> BatchResult:
    """Eqs. 30 and 31: base velocity and rate; no sensor gives the velocity, here it is measured."""
    return solve_momentum(samples, plain, NO_PRIOR)


def _ce(samples: SampleSet, plain: Problem) -> BatchResult:
    """Eqs. 32 to 34, the measured energy read as the motors' work."""
    return solve_energy(replace(samples, v_NB_B=None), plain, NO_PRIOR)


PAPER_METHODS: Mapping[str, Callable[[SampleSet, Problem], BatchResult]] = {
    "mrnea": _mrnea,
    "rda": _rda,
    "cm": _cm,
    "ce": _ce,
}


def judged(unit: Unit, result: BatchResult) -> dict[str, Any]:
    """Return a result's errors against the truth; of the fused one the Cramer-Rao bound's too."""
    k = slice(0, 10 * len(scenario_of(unit.orbit, unit.system, unit.acting).unknown))
    found = scored(unit, result.mean[k], np.array(result.covariance[k, k]), result.status)
    if result.method == "fused":
        found |= _spread(unit, np.array(result.crb[k, k]), "bound")
    return found


def scored(unit: Unit, x: FloatArray, covariance: FloatArray, status: str) -> dict[str, Any]:
    """Return end-effector errors, parameters, and what the covariance lets expect."""
    scenario = scenario_of(unit.orbit, unit.system, unit.acting)
    truth, tool = truth_of(scenario), verification(unit.orbit, unit.system)
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(covariance))):
        raise EstimatorError(f"{status}: not finite")
    values = {
        "status": status,
        "x": x.tolist(),
        "report": [report_of(x[10 * i : 10 * i + 10]).tolist() for i in range(len(x) // 10)],
        "nees": normalised_error_squared(x - truth, covariance),
        **tool.error(x, truth).summary(),
    }
    return values | _spread(unit, covariance, "expected")


def _spread(unit: Unit, covariance: FloatArray, prefix: str) -> dict[str, float]:
    """Return the mean end-effector errors of draws from a covariance about the truth."""
    truth = truth_of(scenario_of(unit.orbit, unit.system, unit.acting))
    tool = verification(unit.orbit, unit.system)
    rng = np.random.default_rng(np.random.SeedSequence(unit.seed, spawn_key=(DRAW_STREAM,)))
    draws = rng.multivariate_normal(truth, covariance, DRAWS, "ignore", method="eigh")
    found = tool.error(draws, truth).summary()
    return {f"{prefix}_{name}": value for name, value in found.items()}


@lru_cache(maxsize=6)
def verification(orbit: str, system: str) -> Verification:
    """Return the verification motion of a system."""
    scenario = scenario_of(orbit, system, "none")
    pis = {body: pi_of(report) for body, report in scenario.truth.items()}
    robot = FloatingRobot(scenario.urdf, scenario.tool_frame, pis, scenario.unknown)
    spline = JointSpline.load(scenario.verification)
    return Verification(robot, lambda t: spline.evaluate(t)[:2], spline.duration_s)
