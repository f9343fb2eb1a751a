"""The final estimate of a run as a result to be scored, from memory or from a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fsw.messages import BodyEstimate, Estimate
from hil.judge.score import Result, result_from, rows
from hil.world.inertia import FloatArray


def result_of(estimate: Estimate | None, unknown: Sequence[str]) -> Result:
    """Return the final result; without any estimate an invalid one that says so."""
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
    """Return the report (10,) of a published body."""
    return np.concatenate(([body.mass_kg], body.com_m, body.inertia_kg_m2))


def body_sigma(body: BodyEstimate) -> FloatArray:
    """Return the 1 sigma (10,) of a published body's report."""
    return np.concatenate(([body.mass_sigma_kg], body.com_sigma_m, body.inertia_sigma_kg_m2))
