"""The final estimate of a run as a `Result` for the score, from memory or a recording."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fsw.messages import BodyEstimate, Estimate
from hil.judge.score import Result, result_from, rows
from hil.world.inertia import FloatArray

CONFIDENT = 5.0  # an error of a valid estimate above so many sigmas is wrong


def result_of(estimate: Estimate | None, unknown: Sequence[str]) -> Result:
    """Return the final result; if the estimate is None, an invalid one with NO_ESTIMATE."""
    if estimate is None:
        size = 10 * len(unknown)
        return result_from(unknown, np.ones(size), np.eye(size), valid=False, reason="NO_ESTIMATE")
    result = result_from(
        unknown,
        estimate.mean,
        estimate.covariance,
        valid=estimate.valid,
        reason=estimate.reason,
    )
    return replace(
        result,
        reports={b: body_report(estimate.bodies[b]) for b in unknown},
        sigmas={b: body_sigma(estimate.bodies[b]) for b in unknown},
    )


def result_from_json(values: Mapping[str, Any], unknown: Sequence[str]) -> Result:
    """Return the result of a recorded /estimate message."""
    result = result_from(
        unknown,
        np.array(values["mean"]),
        np.array(values["covariance"]),
        valid=bool(values["valid"]),
        reason=str(values["reason"]),
    )
    return replace(
        result,
        reports={b: rows(values["estimate"][b]) for b in unknown},
        sigmas={b: rows(values["sigma"][b]) for b in unknown},
    )


def body_report(body: BodyEstimate) -> FloatArray:
    """Return the report (10,) of a published body estimate."""
    return np.concatenate(([body.mass_kg], body.com_m, body.inertia_kg_m2))


def body_sigma(body: BodyEstimate) -> FloatArray:
    """Return the 1 sigma (10,) of a published body estimate's report."""
    return np.concatenate(([body.mass_sigma_kg], body.com_sigma_m, body.inertia_sigma_kg_m2))


def worst(bodies: Mapping[str, BodyEstimate], truth: Mapping[str, FloatArray]) -> float:
    """Return the largest |error| over sigma of mass, centre of mass and inertia of all bodies."""
    return max(
        float(np.max(np.abs(body_report(body) - truth[name]) / body_sigma(body)))
        for name, body in bodies.items()
    )


def outputs(estimates: Sequence[Estimate], truth: Mapping[str, FloatArray]) -> dict[str, int]:
    """Return how many published estimates are valid, and how many of the valid are wrong.

    An estimate is wrong if any value of a body is over `CONFIDENT` sigmas from the truth.
    """
    valid = [estimate for estimate in estimates if estimate.valid]
    wrong = sum(worst(estimate.bodies, truth) > CONFIDENT for estimate in valid)
    return {"valid": len(valid), "wrong": wrong}
