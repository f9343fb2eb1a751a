"""Mistakes in data of others, or in how they are mapped: made in columns, mapping or configuration.

Each one changes the joints' columns, the inertial unit's columns, the mapping or the configuration
of `sampled_cases` in place.
"""

import copy
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from tests.support.sampled_cases import EPOCH_S, Columns

SECONDS = {"column": "t", "unit": "s"}
MAPPING = {
    "joints": {
        "time": SECONDS,
        "file": "joints.csv",
        "position": {"columns": "q_{}", "unit": "rad"},
        "torque": {"columns": "tau_{}", "unit": "N m"},
    },
    "imu": {
        "time": SECONDS,
        "file": "imu.csv",
        "rate": {"columns": "w{}", "unit": "rad/s"},
        "specific_force": {"columns": "f{}", "unit": "m/s2"},
    },
}
Data = tuple[Columns, Columns, dict[str, Any], dict[str, Any]]
FRICTION_NM, FRICTION_NMS_RAD = 0.5, 0.8


def scaled(prefix: str, factor: float) -> Callable[..., None]:
    def change(joints: Columns, imu: Columns, *_: object) -> None:
        for columns in (joints, imu):
            for name in columns:
                if name.startswith(prefix) and name != "t":
                    columns[name] = factor * columns[name]

    return change


def exchanged(kind: str) -> Callable[..., None]:
    def change(joints: Columns, *_: object) -> None:
        one, other = f"{kind}_joint2", f"{kind}_joint3"
        joints[one], joints[other] = joints[other], joints[one]

    return change


def late(seconds: float) -> Callable[..., None]:
    def change(_: Columns, imu: Columns, *__: object) -> None:
        imu["t"] = imu["t"] + seconds

    return change


def rubbing(joints: Columns, *_: object) -> None:
    for k in range(1, 8):
        speed = np.gradient(joints[f"q_joint{k}"], joints["t"])
        friction = FRICTION_NM * np.tanh(speed / 0.01) + FRICTION_NMS_RAD * speed
        joints[f"tau_joint{k}"] = joints[f"tau_joint{k}"] + friction


def with_wide_limits(change: Callable[..., None]) -> Callable[..., None]:
    """Also set limits as placeholders of a URDF, so that import and sources accept the values."""

    def both(joints: Columns, imu: Columns, _: object, config: dict[str, Any]) -> None:
        change(joints, imu)
        for joint in config["joints"]:
            joint |= {"speed_limit_rad_s": 50.0, "torque_limit_nm": 1e5}

    return both


def gravity_up(_: Columns, __: Columns, ___: object, config: dict[str, Any]) -> None:
    config["base"]["gravity_B_m_s2"] = [-v for v in config["base"]["gravity_B_m_s2"]]


def _as(section: str, key: str, unit: str) -> Callable[..., None]:
    def change(_: Columns, __: Columns, mapping: dict[str, Any], *___: object) -> None:
        mapping[section][key]["unit"] = unit

    return change


UNDER_GRAVITY = {
    "sign of all torques": scaled("tau_", -1.0),
    "sign of all positions": scaled("q_", -1.0),
    "torques of two joints exchanged": exchanged("tau"),
    "angles of two joints exchanged": exchanged("q"),
    "friction not declared": rubbing,
    "specific force in g": scaled("f", 1.0 / 9.80665),
    "angles in degrees": with_wide_limits(scaled("q_", math.degrees(1.0))),
    "torques in mN m": with_wide_limits(scaled("tau_", 1e3)),
    "gravity of the other sign": gravity_up,
}
IN_FREE_FLOAT = {
    "clock of the inertial unit 10 ms late": late(0.01),
    "clock of the inertial unit 30 ms early": late(-0.03),
    "rates in degrees": scaled("w", math.degrees(1.0)),
}


def spoiled(change: Callable[..., None], joints: Columns, imu: Columns, config: Any) -> Data:
    """Return copies of columns, mapping and configuration with a mistake."""
    data = copy.deepcopy((joints, imu, MAPPING, config))
    for columns in data[:2]:
        columns["t"] = columns["t"] + EPOCH_S
    change(*data)
    return data
