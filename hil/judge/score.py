"""The score of a run: errors against the truth, consistency, tool error, bound, and a table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from hil.judge import chi_square
from hil.judge.applied import Doubt, applied_in
from hil.judge.bound import Sensors, Summed
from hil.judge.endeffector import ToolError, Verification
from hil.judge.floating import FloatingRobot
from hil.judge.unknown_motion import Encoders
from hil.world.history import TruthState
from hil.world.inertia import (
    COUNT,
    LABELS,
    FloatArray,
    pi_jacobian,
    pi_of,
    report_covariance,
    report_of,
)
from hil.world.prior import Prior
from hil.world.scenario import mapping_from

DRAWS = 200
BOUND_RATE_HZ = 10.0  # of the sum over the motion; exact to 1e-8 for motions below 1 Hz


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """A final estimate of the unknown bodies, in the flight software's coordinates pi.

    x (10 b,) and covariance (10 b, 10 b) hold ten parameters pi per unknown body, base first,
    before a projection to the nearest physical body.
    """

    valid: bool
    reason: str
    x: FloatArray
    covariance: FloatArray
    reports: dict[str, FloatArray]  # as published
    sigmas: dict[str, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """Truth, prior and bound with which a result is compared."""

    unknown: tuple[str, ...]
    truth: dict[str, FloatArray]  # reports
    priors: dict[str, Prior]
    robot: FloatingRobot
    verification: Verification
    bound_sigmas: dict[str, FloatArray]  # of the reports, if the joints' motion is known exactly
    true_bound_sigmas: dict[str, FloatArray]  # of the reports, if encoders show the motion

    @property
    def x_truth(self) -> FloatArray:
        """True parameters pi (10 b,) of the unknown bodies, stacked."""
        return stacked(self.truth, self.unknown)

    @property
    def x_prior(self) -> FloatArray:
        """Prior means of pi (10 b,) of the unknown bodies, stacked."""
        return stacked({b: p.report for b, p in self.priors.items()}, self.unknown)


def stacked(reports: Mapping[str, FloatArray], unknown: Sequence[str]) -> FloatArray:
    """Return the parameters pi (10 b,) of the bodies, one after the other."""
    return np.concatenate([pi_of(reports[body]) for body in unknown])


def normalised_error_squared(error: FloatArray, covariance: FloatArray) -> float:
    """Return e^T P^-1 e, solved with the correlation matrix, which is better conditioned."""
    scale = np.sqrt(np.diag(covariance))
    z = error / scale
    correlation = covariance / np.outer(scale, scale)
    return float(z @ np.linalg.solve(correlation, z))


def bound_sigmas(
    robot: FloatingRobot,
    sensors: Sensors,
    truth: Mapping[str, FloatArray],
    priors: Mapping[str, Prior],
    motion: tuple[FloatArray, FloatArray, FloatArray],
    rate_hz: float = BOUND_RATE_HZ,
) -> dict[str, FloatArray]:
    """Return the Cramer-Rao sigma (10,) of each unknown body's report, prior included.

    `motion` is the true (q, qd, qdd) of the run sampled at `rate_hz`, known exactly.
    """
    x = stacked(truth, list(priors))
    return _sigmas(Summed(robot, sensors, x, motion, rate_hz).information(), x, priors)


def both_bounds(
    robot: FloatingRobot,
    sensors: Sensors,
    encoders: Encoders,
    truth: Mapping[str, FloatArray],
    priors: Mapping[str, Prior],
    state: TruthState,
    doubts: Sequence[Doubt] = (),
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Return `bound_sigmas` for a motion known exactly, and for one that encoders show.

    `state` is the truth of the run sampled at BOUND_RATE_HZ, `doubts` the unknown errors of wheels
    and thrusters.
    """
    x, motion = stacked(truth, list(priors)), (state.q, state.qd, state.qdd)
    applied = applied_in(robot, x, state)
    summed = Summed(robot, sensors, x, motion, BOUND_RATE_HZ, state.R_NB, encoders, applied, doubts)
    exact, shown = summed.information(), summed.information(motion_known=False)
    return _sigmas(exact, x, priors), _sigmas(shown, x, priors)


def _sigmas(
    information: FloatArray, x: FloatArray, priors: Mapping[str, Prior]
) -> dict[str, FloatArray]:
    """Return the sigma (10,) of each body's report by information of the data and the priors."""
    total = information + block_diag(*(prior_information(prior) for prior in priors.values()))
    scale = 1.0 / np.sqrt(np.diag(total))
    correlation = np.linalg.solve(total * np.outer(scale, scale), np.eye(scale.size))
    bound = correlation * np.outer(scale, scale)
    sigmas = {}
    for k, body in enumerate(priors):
        own = slice(COUNT * k, COUNT * (k + 1))
        report = report_covariance(x[own], bound[own, own])
        sigmas[body] = np.sqrt(np.diag(report))
    return sigmas


def prior_information(prior: Prior) -> FloatArray:
    """Return the information (10, 10) about pi in a prior, linearised at the prior."""
    inverse = np.linalg.solve(pi_jacobian(prior.report), np.eye(COUNT))
    return np.asarray(inverse.T @ (inverse / prior.sigma[:, None] ** 2))


def expected_tool_error(case: Case, result: Result, seed: int = 0) -> ToolError:
    """Return tool errors of parameters drawn around the truth with the result's covariance."""
    rng = np.random.default_rng(seed)
    scale = np.sqrt(np.diag(result.covariance))
    values, vectors = np.linalg.eigh(result.covariance / np.outer(scale, scale))
    root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    draws = case.x_truth + rng.standard_normal((DRAWS, scale.size)) @ root.T
    return case.verification.error(draws, case.x_truth)


def score(case: Case, result: Result) -> dict[str, Any]:
    """Return the part of the JSON about one result; bodies are mappings with units in keys."""
    unknown = case.unknown
    ratio = {b: float(result.sigmas[b][0] / case.bound_sigmas[b][0]) for b in unknown}
    efficiency = {b: float(result.sigmas[b][0] / case.true_bound_sigmas[b][0]) for b in unknown}
    return {
        "valid": result.valid,
        "reason": result.reason,
        "truth": {b: mapping_from(case.truth[b]) for b in unknown},
        "estimate": {b: mapping_from(result.reports[b]) for b in unknown},
        "sigma": {b: mapping_from(result.sigmas[b]) for b in unknown},
        "prior": {
            b: mapping_from(case.priors[b].report) | {"sigma": mapping_from(case.priors[b].sigma)}
            for b in unknown
        },
        "crb": {b: mapping_from(case.bound_sigmas[b]) for b in unknown},
        "true_crb": {b: mapping_from(case.true_bound_sigmas[b]) for b in unknown},
        "mass_sigma_to_crb_ratio": ratio,
        "mass_sigma_to_true_crb_ratio": efficiency,
        "ee_error": case.verification.error(result.x, case.x_truth).summary(),
        "ee_error_prior": case.verification.error(case.x_prior, case.x_truth).summary(),
        "ee_error_expected": expected_tool_error(case, result).summary(),
        "nees": normalised_error_squared(result.x - case.x_truth, result.covariance),
        "dof": COUNT * len(unknown),
    }


def comparison(case: Case, result: Result) -> dict[str, Any]:
    """Return the short score of another method's result on the same data."""
    bias = {
        b: float((result.reports[b][0] - case.truth[b][0]) / case.truth[b][0]) for b in case.unknown
    }
    return {
        "estimate": {b: mapping_from(result.reports[b]) for b in case.unknown},
        "sigma": {b: mapping_from(result.sigmas[b]) for b in case.unknown},
        "mass_error_ratio": bias,
        "ee_error": case.verification.error(result.x, case.x_truth).summary(),
        "nees": normalised_error_squared(result.x - case.x_truth, result.covariance),
        "dof": COUNT * len(case.unknown),
    }


def result_from(
    unknown: Sequence[str],
    x: FloatArray,
    covariance: FloatArray,
    *,
    valid: bool,
    reason: str,
) -> Result:
    """Return a result whose reports and sigmas are computed from x and covariance."""
    reports, sigmas = {}, {}
    for k, body in enumerate(unknown):
        own = slice(COUNT * k, COUNT * (k + 1))
        reports[body] = report_of(x[own])
        sigmas[body] = np.sqrt(np.diag(report_covariance(x[own], covariance[own, own])))
    size = COUNT * len(unknown)
    return Result(
        valid=valid,
        reason=reason,
        x=np.array(x[:size]),
        covariance=np.array(covariance[:size, :size]),
        reports=reports,
        sigmas=sigmas,
    )


def nees_words(outcome: Mapping[str, Any]) -> str:
    """Return a text with a run's NEES and the middle 95 % of the chi-square distribution."""
    low, high = chi_square.ends(outcome["dof"])
    return (
        f"NEES {outcome['nees']:.1f} for {outcome['dof']} parameters"
        f" (95 % of right runs: {low:.1f} to {high:.1f})"
    )


def exact_words(outcome: Mapping[str, Any]) -> list[str]:
    """Return a line per body: what the same data give if arm, scales and mountings are exact."""
    exact = outcome.get("exact")
    if exact is None:
        return []
    state = "valid" if exact["valid"] else f"not valid: {exact['reason']}"
    return [
        f"{body}, same data, arm, scales and mountings known exactly: "
        f"{exact['estimate'][body]['mass_kg']:.6g} +- {exact['sigma'][body]['mass_kg']:.3g} kg, "
        f"NEES {exact['nees']:.1f}, {state}"
        for body in outcome["unknown"]
    ]


def bound_words(outcome: Mapping[str, Any], body: str) -> str:
    """Return how far the sigma of a body's mass is from both bounds."""
    known = outcome["mass_sigma_to_crb_ratio"][body]
    shown = outcome["mass_sigma_to_true_crb_ratio"][body]
    doubted = " and arm, scales and mountings exact" if outcome.get("exact") else ""
    return (
        f"{shown:.2f} of the Cramer-Rao bound of these sensors, encoders included{doubted}; "
        f"{known:.2f} of the bound with the joints' motion known exactly"
    )


def rows(body: Mapping[str, Any]) -> FloatArray:
    """Return the ten values of a mapping with mass_kg, com_m, inertia_kg_m2."""
    return np.array([body["mass_kg"], *body["com_m"], *body["inertia_kg_m2"]], dtype=np.float64)


def table(outcome: Mapping[str, Any], body: str) -> list[tuple[str, ...]]:
    """Return the table rows of one body; `table_header` names the columns."""
    truth, prior = rows(outcome["truth"][body]), rows(outcome["prior"][body])
    estimate, sigma = rows(outcome["estimate"][body]), rows(outcome["sigma"][body])
    bound = rows(outcome["crb"][body])
    ols = outcome.get("ols")
    columns = [truth, prior, estimate, sigma, bound, estimate - truth]
    lines = []
    for k, label in enumerate(LABELS):
        cells = [_number(column[k], 5 if i < 3 else 3) for i, column in enumerate(columns)]
        cells.append(f"{(estimate[k] - truth[k]) / sigma[k]:+.2f}")
        if ols:
            cells.append(_number(rows(ols["estimate"][body])[k], 5))
        unit = "kg" if k == 0 else "m" if k < 4 else "kg m²"
        lines.append((f"{label} [{unit}]", *cells))
    return lines


def table_header(outcome: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the column titles of `table`."""
    titles = ("", "truth", "prior", "estimate", "1 sigma", "bound", "error", "in sigma")
    return (*titles, "raw OLS") if outcome.get("ols") else titles


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}g}" if abs(value) < 1e5 else f"{value:.3e}"
