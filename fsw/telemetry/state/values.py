"""Converts status, estimates and jobs to the fields of the housekeeping sets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from fsw.config.telemetry import BUS_SLOTS, JOINT_SLOTS
from fsw.messages import BodyEstimate, Estimate
from fsw.telemetry.dictionary.codes import (
    JOB_STATE,
    METHOD,
    REASON,
    RESULT_STATUS,
    UNKNOWN,
)
from fsw.telemetry.dictionary.housekeeping import (
    AXES,
    COORDINATES,
    DELAYS,
    INERTIA,
    REASONS,
    STATES,
    TASKS,
)
from fsw.telemetry.dictionary.types import Enumeration

if TYPE_CHECKING:
    from fsw.telemetry.state.residuals import TorqueResidual

Values = dict[str, Any]
BODIES = ("base", "target")
OTHER = 255


def loop_values(status: Mapping[str, Any], age_s: float) -> Values:
    """Return timing, windows and ring of the loop's summary; `age_s` is the summary's age [s]."""
    windows, ring = status.get("windows", {}), status.get("ring", {})
    values: Values = {
        "ticks": status.get("ticks", 0),
        "slips": status.get("slips", 0),
        "max_late_us": status.get("max_late_us", 0.0),
        "summary_age_s": age_s,
        "ring_records": ring.get("records", 0),
        "ring_dropped": ring.get("dropped", 0),
    }
    values |= _times("work", status.get("work_us", {}))
    for task in TASKS:
        values |= _times(task, status.get("tasks_us", {}).get(task, {}))
    for name in DELAYS:
        values |= _times(name, status.get(f"{name}_us", {}))
    words = ("closed", "unusable", "outliers", "early", "future", "overflow")
    return values | {f"windows_{word}": windows.get(word, 0) for word in words}


def _times(prefix: str, times: Mapping[str, float]) -> Values:
    return {f"{prefix}_{kind}_us": times.get(kind, 0.0) for kind in ("last", "mean", "max")}


def device_values(
    status: Mapping[str, Any],
    buses: Sequence[str],
    joints: Sequence[str],
    links: Mapping[str, str],
) -> Values:
    """Return link state and counters of every device, and the motor values of every joint.

    `links`: the bus or feed of a sensor that has no line of its own, by name of the sensor.
    """
    names = {f"bus{k}": "" for k in range(1, BUS_SLOTS + 1)}
    names |= {f"bus{k}": name for k, name in enumerate(buses[:BUS_SLOTS], start=1)}
    names |= {"imu": "imu", "star_tracker": "star_tracker"}
    values: Values = {}
    for slot, name in names.items():
        link = status.get("links", {}).get(links.get(name, name), {})
        samples = status.get("samples", {}).get(name, {})
        values[f"{slot}_up"] = bool(link.get("up", False))
        values[f"{slot}_losses"] = link.get("losses", 0)
        for word in ("received", "accepted", "lost", "late", "rejected"):
            values[f"{slot}_{word}"] = samples.get(word, 0)
        for reason in REASONS:
            values[f"{slot}_reject_{reason}"] = samples.get(f"reject_{reason}", 0)
    return values | _motor_values(status.get("joints", {}), joints)


def _motor_values(motors: Mapping[str, Mapping[str, float]], joints: Sequence[str]) -> Values:
    values: Values = {}
    for k in range(1, JOINT_SLOTS + 1):
        motor = motors.get(joints[k - 1], {}) if k <= len(joints) else {}
        values[f"joint_{k}_motor_present"] = bool(motor)
        values[f"joint_{k}_velocity"] = motor.get("velocity_rad_s", 0.0)
        for word in ("motor_torque_ratio", "temperature_degc"):
            values[f"joint_{k}_{word}"] = motor.get(word, 0.0)
    return values


def body_values(prefix: str, body: BodyEstimate | None) -> Values:
    """Return a body's parameters and their 1 sigma; zeros if the body is None."""
    if body is None:
        return plain_body_values(prefix, None, None) | {f"{prefix}_consistent": False}
    mean = {"mass_kg": body.mass_kg, "com_m": body.com_m, "inertia_kg_m2": body.inertia_kg_m2}
    sigma = {
        "mass_kg": body.mass_sigma_kg,
        "com_m": body.com_sigma_m,
        "inertia_kg_m2": body.inertia_sigma_kg_m2,
    }
    consistent = {f"{prefix}_consistent": body.physically_consistent}
    return plain_body_values(prefix, mean, sigma) | consistent


def plain_body_values(
    prefix: str, mean: Mapping[str, Any] | None, sigma: Mapping[str, Any] | None
) -> Values:
    """Return the fields of a body in plain values (None: zeros), always marked consistent."""
    values: Values = {f"{prefix}_present": mean is not None, f"{prefix}_consistent": True}
    zero: Mapping[str, Any] = {"mass_kg": 0.0, "com_m": [0.0] * 3, "inertia_kg_m2": [0.0] * 6}
    for start, source in ((prefix, mean or zero), (f"{prefix}_sigma", sigma or zero)):
        values[f"{start}_mass_kg"] = float(source["mass_kg"])
        for axis, x in zip(AXES, source["com_m"], strict=True):
            values[f"{start}_com_{axis}_m"] = float(x)
        for pair, x in zip(INERTIA, source["inertia_kg_m2"], strict=True):
            values[f"{start}_inertia_{pair}_kg_m2"] = float(x)
    return values


def unknown_number(bodies: Sequence[str]) -> int:
    """Return the number of the unknown bodies: base 1, target 2, both 3, none 0."""
    return sum(1 << BODIES.index(body) for body in set(bodies) if body in BODIES)


def _labelled(enumeration: Enumeration, label: str, fallback: int) -> int:
    try:
        return enumeration.value(label.upper())
    except KeyError:
        return fallback


def reason_bits(reasons: Sequence[str]) -> int:
    """Return the bits of the reasons that have a value in the dictionary."""
    numbers = {_labelled(REASON, reason, OTHER) for reason in reasons} - {OTHER}
    return sum(1 << number for number in numbers)


def estimate_values(
    estimate: Estimate | None,
    now_ns: int,
    residuals: Sequence[TorqueResidual],
    joints: Sequence[str],
) -> Values:
    """Return the online estimate; before the first one, zeros with the reason NO_ESTIMATE.

    Parameters
    ----------
    residuals : residual torques, in the order of `joints`
    joints : joint names, in the order of the configuration
    """
    values: Values = {}
    for k in range(JOINT_SLOTS):
        found = residuals[k] if k < len(residuals) else None
        values[f"residual_torque_{k + 1}"] = found.rms_nm if found else 0.0
        values[f"residual_torque_{k + 1}_ratio"] = found.ratio if found else 0.0
    if estimate is None:
        return values | _no_estimate()
    named = dict(zip(estimate.names, estimate.mean.tolist(), strict=True))
    values |= {
        "estimate_time_s": estimate.t_ns * 1e-9,
        "age_s": max(0.0, (now_ns - estimate.t_ns) * 1e-9),
        "valid": estimate.valid,
        "reason": 0 if estimate.valid else _labelled(REASON, estimate.reason, OTHER),
        "reasons": reason_bits(estimate.reasons),
        "method": _labelled(METHOD, estimate.method, 0),
        "unknown": unknown_number(tuple(estimate.bodies)),
        "blocks": estimate.blocks,
        "gated": estimate.gated,
        "nis": estimate.nis,
        "nis_dof": estimate.nis_dof,
        "condition_number": estimate.condition_number,
        "information_gained_nats": estimate.information_gained_nats,
    }
    for key in ("changes", "ignored", "noise_ratio", "innovation_lag1", "innovation_lag1_bound"):
        values[key] = estimate.extra.get(key, 0.0)
    for body in BODIES:
        values |= body_values(body, estimate.bodies.get(body))
    return values | body_values("whole", estimate.whole) | _nuisances(named, joints)


def _nuisances(named: Mapping[str, float], joints: Sequence[str]) -> Values:
    values: Values = {}
    for axis in AXES:
        values[f"acc_bias_{axis}_m_s2"] = named.get(f"acc_bias.{axis}", 0.0)
        values[f"gyro_bias_{axis}_rad_s"] = named.get(f"gyro_bias.{axis}", 0.0)
    offsets = [named.get(f"torque_offset.{name}", 0.0) for name in joints[:JOINT_SLOTS]]
    offsets += [0.0] * (JOINT_SLOTS - len(offsets))
    return values | {f"torque_offset_{k + 1}": x for k, x in enumerate(offsets)}


def _no_estimate() -> Values:
    words = (
        "estimate_time_s age_s valid method unknown blocks gated changes ignored nis nis_dof "
        "noise_ratio innovation_lag1 innovation_lag1_bound condition_number information_gained_nats"
    )
    values: Values = dict.fromkeys(words.split(), 0)
    for body in (*BODIES, "whole"):
        values |= body_values(body, None)
    none = "NO_ESTIMATE"
    values |= {"reason": REASON.value(none), "reasons": reason_bits([none])}
    return values | _nuisances({}, ())


def covariance_values(estimate: Estimate | None) -> Values:
    """Return the covariance of the bodies' coordinates; zeros for a body that is not estimated."""
    bodies = () if estimate is None else tuple(b for b in BODIES if b in estimate.bodies)
    places = {
        f"{body}_{name}": len(COORDINATES) * bodies.index(body) + k
        for body in bodies
        for k, name in enumerate(COORDINATES)
    }
    values: Values = {
        "estimate_time_s": 0.0 if estimate is None else estimate.t_ns * 1e-9,
        "base_present": "base" in bodies,
        "target_present": "target" in bodies,
    }
    size = 0 if estimate is None else len(estimate.mean)
    for row, first in enumerate(STATES):
        for second in STATES[: row + 1]:
            i, j = places.get(first, size), places.get(second, size)
            known = estimate is not None and i < size and j < size
            element = float(estimate.covariance[i, j]) if known and estimate is not None else 0.0
            values[f"cov_{first}_{second}"] = element
    return values


def job_values(job: Mapping[str, Any] | None, method: str, unknown: Sequence[str]) -> Values:
    """Return the batch job and its result; before a result, method and bodies as requested."""
    job = job or {}
    result: Mapping[str, Any] = job.get("result") or {}
    values: Values = {
        "job_id": job.get("id", 0),
        "state": _labelled(JOB_STATE, str(job.get("state", "none")), 0),
        "progress_ratio": job.get("progress", 0.0),
        "method": _labelled(METHOD, str(result.get("method", method)), 0),
        "unknown": unknown_number(result.get("unknown", unknown))
        if job
        else UNKNOWN.value("CONFIGURED"),
        "result_reasons": reason_bits(result.get("reasons", ())),
        "result_status": _labelled(RESULT_STATUS, str(result.get("status", "none")), OTHER),
        "cost": result.get("cost", 0.0),
        "condition_number": result.get("condition_number", 0.0),
        "duration_s": result.get("duration_s", 0.0),
        "text": job.get("text", ""),
    }
    means, sigmas = result.get("estimate", {}), result.get("sigma", {})
    for body in BODIES:
        values |= plain_body_values(body, means.get(body), sigmas.get(body))
    return values
