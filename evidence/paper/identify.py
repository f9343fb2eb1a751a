"""One unit of the study: all its methods on the same samples, judged by the end-effector error."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from evidence.methods import exact
from evidence.methods.cases import WIDER
from evidence.methods.flight_side import problem_of, write_config
from evidence.paper.cases import PaperUnit, exact_sensors, noise_of, scenario_of, truth_of
from evidence.paper.motion import solve_with_motion
from evidence.paper.printed_cm import PrintedMomentum
from evidence.paper.samples import Conditioned, conditioned
from fsw.config import Config
from fsw.errors import EstimatorError
from fsw.estimators.batch.plain import BatchSolution
from fsw.estimators.batch.solver import Target, linear_covariance, regress, solve
from fsw.estimators.measurement.row_functions import Linearisation, row_function
from fsw.estimators.model.problem import Problem
from hil.judge.endeffector import Verification
from hil.judge.score import normalised_error_squared
from hil.world.inertia import FloatArray, report_of

WRENCH = {"external_force_sigma_n": 0.01, "external_torque_sigma_nm": 0.02}
DRAWS = 200
DRAW_STREAM = 137


def run_samples(unit: PaperUnit, rate_hz: float) -> dict[str, Any]:
    """Return the results on one draw of noise by method, as JSON values."""
    with tempfile.TemporaryDirectory(prefix="study-") as folder:
        config = config_of(unit, Path(folder), with_wrench=False)
        noise = noise_of(unit.noise, rate_hz)
        data = conditioned(unit.orbit, unit.system, unit.acting, noise, rate_hz, unit.seed, config)
        plain = problem_of(config)
        pulled = plain
        if unit.acting != "none":
            pulled = problem_of(config_of(unit, Path(folder), with_wrench=True))
    found: dict[str, Any] = {}
    for method in unit.methods:
        try:
            if method == "fused":
                found[method] = _fused(unit, data, plain, pulled)
            else:
                found[method] = _judged(unit, plain, PAPER_METHODS[method](data, plain))
        except (EstimatorError, np.linalg.LinAlgError) as error:
            found[method] = {"status": f"FAILED: {error}"}
    return found


def config_of(unit: PaperUnit, folder: Path, *, with_wrench: bool) -> Config:
    """Return the flight configuration, with a wide prior drawn from the seed.

    As in the paper, it has the gravity gradient and no other part of the environment, and the
    accelerometer is at the origin of the base. Samples begin at the start of the motion.
    """
    scenario = scenario_of(unit.orbit, unit.system, unit.acting)
    told = replace(exact_sensors(scenario, WRENCH if with_wrench else {}), before_s=0.0)
    config = write_config(told, unit.seed, folder, WIDER)
    mounting = config.imu.mounting.model_copy(update={"p_BS_m": (0.0, 0.0, 0.0)})
    imu = config.imu.model_copy(update={"mounting": mounting})
    return config.model_copy(update={"imu": imu})


def _fused(unit: PaperUnit, data: Conditioned, plain: Problem, pulled: Problem) -> dict[str, Any]:
    """Estimate from all channels: bodies, joint motion and, with disturbances, a constant wrench.

    The iteration starts at the estimate for an exact motion, or at the prior if there is none.
    """
    near = solve(plain, row_function("fused", "eiv", plain), data.blocks)
    start = pulled.prior_mean.copy()
    if near.status == "OK":
        start[pulled.bodies] = near.mean[plain.bodies]
    solution = solve_with_motion(pulled, data.blocks, data.curve, start)
    k, bound = pulled.bodies, solution.information.covariance()
    covariance, _ = linear_covariance(pulled, "fused", "eiv", solution)
    found = scored(unit, solution.mean[k], covariance[k, k], solution.status)
    return found | _spread(unit, bound[k, k], "bound")


def _mrnea(data: Conditioned, plain: Problem) -> BatchSolution:
    """Solve eqs. 5 to 16: ordinary least squares with the measured base acceleration."""
    rows = row_function("mrnea", "ols", plain)
    return regress(plain, Target(Linearisation(rows, data.blocks)))


def _rda(data: Conditioned, plain: Problem) -> BatchSolution:
    """Solve eq. 27 with unweighted torque residuals and the motion as exact."""
    rates = [replace(block, cov_gyro=np.zeros_like(block.cov_gyro)) for block in data.blocks]
    start = solve(plain, row_function("mrnea", "eiv", plain), data.blocks).mean
    return solve(plain, row_function("rda", "eiv", plain), rates, start=start)


def _cm(data: Conditioned, plain: Problem) -> BatchSolution:
    """Solve eqs. 30 and 31 for base velocity and rate; the velocity is assumed to be measured."""
    rows = PrintedMomentum(plain, data.velocity_m_s, data.velocity_sigma_m_s)
    return solve(plain, rows, data.blocks)


def _ce(data: Conditioned, plain: Problem) -> BatchSolution:
    """Solve eqs. 32 to 34 with the work of the motors as the measured energy."""
    start = solve(plain, row_function("mrnea", "eiv", plain), data.blocks).mean
    return solve(plain, row_function("ce", "eiv", plain), data.blocks, start=start)


PAPER_METHODS: Mapping[str, Callable[[Conditioned, Problem], BatchSolution]] = {
    "mrnea": _mrnea,
    "rda": _rda,
    "cm": _cm,
    "ce": _ce,
}


def _judged(unit: PaperUnit, problem: Problem, solution: BatchSolution) -> dict[str, Any]:
    """Return the scores of a solution against the truth."""
    k, covariance = problem.bodies, solution.information.covariance()
    return scored(unit, solution.mean[k], covariance[k, k], solution.status)


def scored(unit: PaperUnit, x: FloatArray, covariance: FloatArray, status: str) -> dict[str, Any]:
    """Return parameters, NEES, tool errors and expected ones; EstimatorError if x is not finite."""
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


def _spread(unit: PaperUnit, covariance: FloatArray, prefix: str) -> dict[str, float]:
    """Return the mean end-effector errors of draws from a covariance (p, p) about the truth."""
    truth = truth_of(scenario_of(unit.orbit, unit.system, unit.acting))
    tool = verification(unit.orbit, unit.system)
    rng = np.random.default_rng(np.random.SeedSequence(unit.seed, spawn_key=(DRAW_STREAM,)))
    draws = rng.multivariate_normal(truth, covariance, DRAWS, "ignore", method="eigh")
    found = tool.error(draws, truth).summary()
    return {f"{prefix}_{name}": value for name, value in found.items()}


@lru_cache(maxsize=6)
def verification(orbit: str, system: str) -> Verification:
    """Return the verification of a system: the motion on which the tool's error is predicted."""
    return exact.verification(scenario_of(orbit, system, "none"))
