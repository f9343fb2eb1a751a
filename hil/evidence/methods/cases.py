"""Cases of the study: sensor sets and levels; and the result of one method on one seed."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from hil.evidence.methods.sensed import ChannelNoise
from hil.world.inertia import COUNT, FloatArray, pi_of
from hil.world.scenario import Scenario, load

CASES: Mapping[str, str] = {"base": "base", "target": "target_leo", "both": "both"}
UNKNOWN = {"base": ("base",), "target": ("target",), "both": ("base", "target")}
GROUPS: Mapping[str, slice] = {
    "mass": slice(0, 1),
    "first moment": slice(1, 4),
    "inertia": slice(4, 10),
}
SAMPLE, DEVICE = "sample", "device"
RATE_HZ = 100.0
DURATION_S = 60.0
WINDOW_S, NODES = 0.4, 4  # of the conditioner
ENCODER_NOISE_RAD = 1.1e-7  # 24 bits, rounded
WIDER = 100.0  # times the prior's sigma: what is judged is what the data says


def _sensor_set(gyro_factor: float, acc_factor: float) -> ChannelNoise:
    """Return torque 0.05 N m and 24-bit encoders at 500 Hz, a STIM300 times the factors.

    White noise at native rates averaged to the study's rate.
    """
    averaged = (RATE_HZ / 500.0) ** 0.5
    return ChannelNoise(
        position_rad=ENCODER_NOISE_RAD * averaged,
        torque_nm=0.05 * averaged,
        rate_rad_s=4.4e-5 * RATE_HZ**0.5 * gyro_factor,
        acceleration_m_s2=5.0e-4 * RATE_HZ**0.5 * acc_factor,
    )


SENSOR_SETS: Mapping[str, ChannelNoise] = {
    "data sheet": _sensor_set(1.0, 1.0),
    "poor IMU": _sensor_set(3.0, 10.0),  # 0.45 deg/sqrt(h), 0.3 m/s/sqrt(h): consumer grade
    "good IMU": _sensor_set(0.01, 0.01),  # 0.0015 deg/sqrt(h), 0.0003 m/s/sqrt(h): navigation
}


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Key:
    """Names one result of the study."""

    level: str
    case: str
    sensors: str
    method: str
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StudyRecord:
    """One method's result on one seed.

    error (10 b,) is estimate minus truth in pi of the unknown bodies, None when the method failed;
    nees its square in the method's own covariance; sigma (10 b,) from that covariance.
    """

    key: Key
    status: str
    error: FloatArray | None
    sigma: FloatArray | None
    nees: float
    iterations: int
    bias_note: str = ""
    commit: str = ""  # of the code that gave it


@lru_cache(maxsize=8)
def scenario_of(case: str) -> Scenario:
    """Return the scenario of a case; FILE:CASE is that of a file, with the case's unknowns."""
    file, _, own = case.rpartition(":")
    return replace(load(file), unknown=UNKNOWN[own]) if file else load(CASES[case])


def truth_of(case: str) -> FloatArray:
    """Return the true parameters pi of the unknown bodies, stacked."""
    scenario = scenario_of(case)
    return np.concatenate([pi_of(scenario.truth[body]) for body in scenario.unknown])


def group_slices(case: str) -> dict[str, slice]:
    """Return the parameter groups of the unknown bodies, by "body group"."""
    slices = {}
    for index, body in enumerate(scenario_of(case).unknown):
        for name, own in GROUPS.items():
            start = COUNT * index
            slices[f"{body} {name}"] = slice(start + own.start, start + own.stop)
    return slices


def settings() -> dict[str, Any]:
    """Return what a stored result depends on beside its key; results of others are not mixed in."""
    from dataclasses import asdict

    return {
        "version": 2,
        "rate_hz": RATE_HZ,
        "duration_s": DURATION_S,
        "cases": dict(CASES),
        "window_s": WINDOW_S,
        "nodes": NODES,
        "sensor_sets": {name: asdict(values) for name, values in SENSOR_SETS.items()},
    }
