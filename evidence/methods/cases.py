"""Cases, sensor sets and levels of the study, and the result of one method on one seed."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from evidence.methods.sensed import ChannelNoise
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
ENCODER_NOISE_RAD = 1.1e-7  # rounding to 24 bits
WIDER = 100.0  # factor on the prior's sigma, so that the data and not the prior is judged


def _sensor_set(gyro_factor: float, acc_factor: float) -> ChannelNoise:
    """Return the noise of torque 0.05 N m, 24-bit encoders, and a STIM300 times the factors.

    Torque and encoder noise is white at 500 Hz and averaged to the rate of the study.
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
    """The key of one result of the study."""

    level: str
    case: str
    sensors: str
    method: str
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StudyRecord:
    """The result of one method on one seed, for b unknown bodies.

    `error` (10 b,) is the estimate of pi minus the truth; None if the method failed. `sigma`
    (10 b,) and `nees` come from the covariance of the method.
    """

    key: Key
    status: str
    error: FloatArray | None
    sigma: FloatArray | None
    nees: float
    iterations: int
    bias_note: str = ""
    commit: str = ""  # of the code that made the result


@lru_cache(maxsize=8)
def scenario_of(case: str) -> Scenario:
    """Return the scenario of a case, or of this name.

    FILE:CASE is a scenario file with the unknowns of the case.
    """
    file, _, own = case.rpartition(":")
    if file:
        return replace(load(file), unknown=UNKNOWN[own])
    return load(CASES.get(case, case))


def truth_of(case: str) -> FloatArray:
    """Return the true parameters pi of the b unknown bodies, stacked (10 b,)."""
    scenario = scenario_of(case)
    return np.concatenate([pi_of(scenario.truth[body]) for body in scenario.unknown])


def group_slices(case: str) -> dict[str, slice]:
    """Return the slices of the parameter groups, by "body group", such as "base mass"."""
    slices = {}
    for index, body in enumerate(scenario_of(case).unknown):
        for name, own in GROUPS.items():
            start = COUNT * index
            slices[f"{body} {name}"] = slice(start + own.start, start + own.stop)
    return slices


def settings() -> dict[str, Any]:
    """Return the settings on which a stored result depends, besides its key."""
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
