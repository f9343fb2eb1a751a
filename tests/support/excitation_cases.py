"""Subjects, limits and motions for the excitation tests."""

from functools import lru_cache
from pathlib import Path

import numpy as np

from evidence.excitation import cases
from fsw.config import Config
from planner.limits import MotionLimits
from planner.limits import load as load_limits
from planner.spline import SplineLayout
from planner.subject import Subject, build_subject

LIMITS_FILE = Path(cases.LIMITS)
SYSTEMS = tuple(cases.SYSTEMS)
SHORT = SplineLayout(duration_s=12.0, intervals=6, n=7, closed=False)

PANEL = {
    "name": "panel",
    "kind": "panel",
    "p_B_m": (0.5, 0.0, 0.0),
    "axes_B": ((0.0, 1.0, 0.0),),
    "mass_kg": 20.0,
    "com_m": (1.5, 0.0, 0.0),
    "inertia_kg_m2": (1.0, 0.0, 0.0, 15.0, 0.0, 15.0),
    "frequency_hz": 0.2,
    "damping_ratio": 0.01,
    "amplitude_rad": 0.01,
}


@lru_cache(maxsize=3)
def subject(system: str = "target") -> Subject:
    return cases.subject(system)


def panelled() -> Subject:
    """Return the target's subject on a spacecraft with a hinged panel."""
    document = cases.config("target").model_dump() | {"modes": (PANEL,)}
    return build_subject(Config.model_validate(document))


def limits(**changes: object) -> MotionLimits:
    return MotionLimits.model_validate(load_limits(LIMITS_FILE).model_dump() | changes)


def motion(layout: SplineLayout = SHORT, seed: int = 0, size_rad: float = 0.3) -> np.ndarray:
    """Return variables of a random motion about a bent pose."""
    rng = np.random.default_rng(seed)
    pose = np.array([0.3, 0.5, -0.2, -1.0, 0.4, 0.6, 0.1])
    return (pose + size_rad * rng.standard_normal((layout.rows, layout.n))).ravel()
