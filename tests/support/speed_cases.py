"""Joints of table 1's robot that are known by speed only: configuration and sampled windows."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.messages import FloatArray, Window
from hil.world.history import TruthHistory
from tests.support.estimator_cases import RATE_HZ, WINDOW_S, make_config, sampled_window

TURNING = (1, 3)  # joints without positions
SPEED_NOISE_RAD_S = 0.01
DENSITY = SPEED_NOISE_RAD_S**2 / RATE_HZ  # rad^2/s of the walk
START_SIGMA_RAD = 2e-3


def speed_config(
    start_rad: FloatArray, noise_rad_s: float = SPEED_NOISE_RAD_S, **options: Any
) -> Config:
    """Return the configuration; the joints that turn begin at the angles (7,)."""
    config = make_config(**options)
    joints = [joint.model_dump() for joint in config.joints]
    for k in TURNING:
        joints[k] |= {
            "encoder": "speed",
            "speed_noise_rad_s": noise_rad_s,
            "start_rad": float(start_rad[k]),
            "zero_sigma_rad": START_SIGMA_RAD,
        }
    return config.with_sections(joints=joints)


def speed_windows(
    history: TruthHistory, seed: int, start_s: float, stop_s: float, noise_rad_s: float
) -> Iterator[Window]:
    """Yield sampled windows in which some joints give speeds, under white noise."""
    rng, of_speed = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    for index in range(int(np.floor((stop_s - start_s) / WINDOW_S + 1e-9))):
        window = sampled_window(history, rng, start_s + index * WINDOW_S, index)
        joints = list(window.joints)
        for k in TURNING:
            t_s, values = joints[k].t_ns * 1e-9, joints[k].values.copy()
            values[:, 0] = history.at(t_s).qd[:, k] + noise_rad_s * of_speed.normal(size=len(t_s))
            joints[k] = replace(joints[k], values=values)
        yield replace(window, joints=tuple(joints))
