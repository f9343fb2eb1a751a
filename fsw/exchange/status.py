"""Status summaries: counters, times and estimates as plain JSON values, in the words of the CLI."""

import math
from collections.abc import Mapping
from typing import Any

from fsw.messages import BodyEstimate, Estimate
from fsw.scheduler.tasks import Slips, TaskTimes

STATUS_NAME = "status.json"  # in the state directory


def source_samples(counters: Mapping[str, int], late: int) -> dict[str, int]:
    """Return one source's counters: received, lost, late, rejected, then the rest."""
    first = {"received": counters.get("received", 0), "lost": counters.get("lost", 0)}
    words = {**first, "late": late, "rejected": counters.get("rejected", 0)}
    return words | {key: value for key, value in counters.items() if key not in words}


def task_summary(slips: Slips) -> dict[str, dict[str, float]]:
    """Return last, mean, 99th percentile and max time of every task [us]."""
    return {name: time_values(times) for name, times in slips.times.items()}


def time_values(times: TaskTimes) -> dict[str, float]:
    """Return last, mean, 99th percentile and max of one task's times [us]."""
    return {
        "last": times.last_ns / 1e3,
        "mean": round(times.mean_ns / 1e3, 3),
        "p99": times.quantile_ns(0.99) / 1e3,
        "max": times.max_ns / 1e3,
    }


def body_values(body: BodyEstimate) -> dict[str, Any]:
    """Return the estimated parameters of a body (inertia about the centre of mass)."""
    return {
        "mass_kg": body.mass_kg,
        "com_m": [float(x) for x in body.com_m],
        "inertia_kg_m2": [float(x) for x in body.inertia_kg_m2],
    }


def body_sigma(body: BodyEstimate) -> dict[str, Any]:
    """Return the 1-sigma of the parameters that `body_values` gives."""
    return {
        "mass_kg": body.mass_sigma_kg,
        "com_m": [float(x) for x in body.com_sigma_m],
        "inertia_kg_m2": [float(x) for x in body.inertia_sigma_kg_m2],
    }


def estimate_summary(estimate: Estimate | None) -> dict[str, Any] | None:
    """Return the figures of an estimate for an operator, without its matrices."""
    if estimate is None:
        return None
    return {
        "t_ns": estimate.t_ns,
        "valid": estimate.valid,
        "reason": estimate.reason,
        "reasons": list(estimate.reasons),
        "method": estimate.method,
        "blocks": estimate.blocks,
        "gated": estimate.gated,
        "nis": finite(estimate.nis),
        "nis_dof": estimate.nis_dof,
        "condition_number": finite(estimate.condition_number),
        "information_gained_nats": finite(estimate.information_gained_nats),
        "estimate": {name: body_values(body) for name, body in estimate.bodies.items()},
        "sigma": {name: body_sigma(body) for name, body in estimate.bodies.items()},
        "physically_consistent": {
            name: body.physically_consistent for name, body in estimate.bodies.items()
        },
        "whole": whole_values(estimate.whole),
    }


def whole_values(whole: BodyEstimate | None) -> dict[str, Any] | None:
    """Return parameters and 1-sigma of all bodies together, in B at the current posture."""
    if whole is None:
        return None
    return {**body_values(whole), "sigma": body_sigma(whole)}


def finite(value: float) -> float | None:
    """Return a finite number; None for NaN and infinity, which JSON lacks."""
    return float(value) if math.isfinite(value) else None
