"""A thrown rigid body with one reaction wheel: Euler's equation integrated, and its sensors' CSV.

Nothing of the project: a gyrostat's momentum I w + h a is constant in inertial axes, the centre of
mass falls freely, and an accelerometer at r from it measures wd x r + w x (w x r). Source: Wie,
Space Vehicle Dynamics and Control (2008), sec. 7.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.integrate import solve_ivp
from scipy.special import expit

from tests.support.sampled_cases import Columns

RATE_HZ, LASTS_S = 1000.0, 0.8
MASS_KG = 0.56
COM_M = np.array([0.011, 0.002, 0.039])
INERTIA = np.array([[1.7e-3, 4e-5, -1e-5], [4e-5, 3.4e-4, -2e-5], [-1e-5, -2e-5, 1.65e-3]])
ROTOR_KG_M2 = 1.7e-6
AXIS = np.array([0.0, 0.0, -1.0])
W_START = np.array([9.0, 4.0, 3.0])
EXACT = np.eye(3)
SPEED_RAD_S, RAMP_S = 1250.0, 0.03
URDF = """<robot name="thrown"><link name="body"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>
"""
MAPPING = {
    "time": {"column": "t", "unit": "s"},
    "imu": {
        "rate": {"columns": "w{}", "unit": "rad/s"},
        "specific_force": {"columns": "f{}", "unit": "m/s2"},
    },
    "wheels": {"speed": {"columns": "speed", "unit": "rad/s"}},
}


@dataclass(frozen=True, kw_only=True)
class Noise:
    """1 sigma of a sample, white."""

    rate_rad_s: float = 1e-9
    force_m_s2: float = 1e-7
    speed_rad_s: float = 1e-7


def speed_rad_s(t: np.ndarray) -> np.ndarray:
    """Return the rotor's speed: up, then down again."""
    return SPEED_RAD_S * (expit((t - 0.25) / RAMP_S) - 0.7 * expit((t - 0.55) / RAMP_S))


def _acceleration(t: float, w: np.ndarray) -> np.ndarray:
    step = 1e-5
    h = ROTOR_KG_M2 * speed_rad_s(np.array([t - step, t, t + step]))
    moment = AXIS * (h[2] - h[0]) / (2.0 * step)
    return np.linalg.solve(INERTIA, -np.cross(w, INERTIA @ w + AXIS * h[1]) - moment)


@cache
def _motion(_ramp_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, rates and angular accelerations, which are the same for every seed."""
    t = 1.0 + np.arange(round(LASTS_S * RATE_HZ)) / RATE_HZ
    found = solve_ivp(
        _acceleration, (0.0, LASTS_S), W_START, "DOP853", t - 1.0, rtol=1e-11, atol=1e-11
    )
    w = found.y.T
    return t, w, np.array([_acceleration(*state) for state in zip(t - 1.0, w, strict=True)])


def throw(
    noise: Noise, seed: int = 0, late_s: float = 0.0, gyro_matrix: np.ndarray = EXACT
) -> Columns:
    """Return the columns of a throw; the wheel's readings are late.

    `gyro_matrix` (3, 3) times what the gyro reads is the true rate.
    """
    (t, w, wd), rng = _motion(RAMP_S), np.random.default_rng([seed, 45])
    f = np.cross(wd, -COM_M) + np.cross(w, np.cross(w, -COM_M))
    w = np.linalg.solve(gyro_matrix, w.T).T + rng.normal(0.0, noise.rate_rad_s, w.shape)
    f = f + rng.normal(0.0, noise.force_m_s2, f.shape)
    speed = speed_rad_s(t - 1.0 - late_s) + rng.normal(0.0, noise.speed_rad_s, len(t))
    columns: Columns = {"t": t}
    columns |= {f"w{axis}": w[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"f{axis}": f[:, k] for k, axis in enumerate("xyz")}
    return columns | {"speed": speed}


def write_config(
    folder: Path, noise: Noise, delay_sigma_s: float = 0.0, imu: dict[str, Any] | None = None
) -> Path:
    """Write robot, mapping and configuration, `imu` over its own; return the latter's path."""
    (folder / "body.urdf").write_text(URDF)
    (folder / "mapping.yaml").write_text(yaml.safe_dump(MAPPING))
    path = folder / "thrown.yaml"
    document = {
        "robot": {"urdf": "body.urdf", "tool_frame": "body"},
        "unknown": ["base"],
        "bodies": {
            "base": {
                "mass_kg": MASS_KG,
                "com_m": [0.0, 0.0, 0.03],
                "inertia_kg_m2": [1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3],
                "sigma": {
                    "mass_kg": 1e-4,
                    "com_m": [0.03] * 3,
                    "inertia_kg_m2": [2e-3] * 6,
                },
            }
        },
        "wheels": [
            {
                "name": "wheel",
                "rate_hz": RATE_HZ,
                "axis_B": AXIS.tolist(),
                "inertia_kg_m2": ROTOR_KG_M2,
                "inertia_sigma_ratio": 0.0,
                "speed_limit_rad_s": 3000.0,
                "speed_noise_rad_s": max(noise.speed_rad_s, 0.01),
                "torque_limit_nm": 0.1,
                "torque_walk_nm_sqrt_s": 1.0,
                "delay_sigma_s": delay_sigma_s,
            }
        ],
        "imu": {
            "driver": "samples",
            "rate_hz": RATE_HZ,
            "mounting": {"p_BS_m": [0.0, 0.0, 0.0], "q_BS_xyzw": [0.0, 0.0, 0.0, 1.0]},
            "mounting_position_sigma_m": 0.0,
            "mounting_angle_sigma_rad": 0.0,
            "acc_range_g": 80,
            "gyro_group_delay_s": 0.0,
            "acc_group_delay_s": 0.0,
            "angle_random_walk_rad_sqrt_s": max(noise.rate_rad_s, 1e-5) / RATE_HZ**0.5,
            "velocity_random_walk_m_s_sqrt_s": max(noise.force_m_s2, 1e-3) / RATE_HZ**0.5,
            "gyro_bias_sigma_rad_s": 0.0,
            "acc_bias_sigma_m_s2": 0.0,
            "max_rate_rad_s": 35.0,
            **(imu or {}),
        },
        "scheduler": {"tick_rate_hz": 500.0},
        "estimator": {
            "method": "mrnea",
            "window_s": 0.04,
            "nodes": 5,
            "lag_s": 0.005,
            "settle_blocks": 4,
            "wrench_force_sigma_n": 1e-5,
            "wrench_torque_sigma_nm": 1e-6,
        },
    }
    path.write_text(yaml.safe_dump(document))
    return path


def inertia_vector() -> np.ndarray:
    """Return the true inertia about the centre of mass, xx xy xz yy yz zz."""
    return INERTIA[np.triu_indices(3)]
