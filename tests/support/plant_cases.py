"""An analytic truth and noise-free sensors for the tests of the devices."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from hil.devices.canopen import FieldScale, Reading
from hil.world.sensor_config import SensorConfig

RATE_SLOPE = 0.1  # rad/s^2: the gyro reading over it is its own instant
ACC_SLOPE = 1.0  # m/s^3


class AnalyticHistory:
    """Sines in the joints, and base motion linear in time so that a reading tells its instant."""

    start_s = 0.0
    end_s = 60.0

    def __init__(self, n: int = 7) -> None:
        self.n = n

    def at(self, t_s: Any) -> SimpleNamespace:
        t = np.asarray(t_s, dtype=np.float64)[..., None]
        k = 0.3 * np.arange(1, self.n + 1)
        axis = np.array([1.0, 0.0, 0.0])
        cos, sin = np.cos(0.01 * t[..., 0]), np.sin(0.01 * t[..., 0])
        one, nil = np.ones_like(cos), np.zeros_like(cos)
        rows = [[cos, -sin, nil], [sin, cos, nil], [nil, nil, one]]
        return SimpleNamespace(
            q=np.sin(k * t),
            qd=k * np.cos(k * t),
            tau=10.0 * np.cos(k * t),
            R_NB=np.stack([np.stack(row, axis=-1) for row in rows], axis=-2),
            w_NB_B=RATE_SLOPE * t * axis,
            wd_NB_B=np.zeros((*t.shape[:-1], 3)),
            a_NB_B=ACC_SLOPE * t * axis,
            g_NB_B=np.zeros((*t.shape[:-1], 3)),
            gradient_B=np.zeros((*t.shape[:-1], 3, 3)),
        )


def sensor_config(
    joints: dict[str, Any] | None = None,
    imu: dict[str, Any] | None = None,
    star_tracker: dict[str, Any] | None = None,
) -> SensorConfig:
    """Noise-free sensors, with what the test gives on top."""
    torque = {"torque_noise_nm": 0.0, "torque_offset_sigma_nm": 0.0}
    inertial = {
        "p_BS_m": [0.0, 0.0, 0.0],
        "q_BS_xyzw": [0.0, 0.0, 0.0, 1.0],
        "angle_random_walk_rad_sqrt_s": 0.0,
        "velocity_random_walk_m_s_sqrt_s": 0.0,
        "gyro_bias_sigma_rad_s": 0.0,
        "acc_bias_sigma_m_s2": 0.0,
    }
    tracker = {"q_BS_xyzw": [0.0, 0.0, 0.0, 1.0], "subscribed": True}
    return SensorConfig.from_dict(
        {
            "joints": torque | (joints or {}),
            "imu": inertial | (imu or {}),
            "star_tracker": tracker | (star_tracker or {}),
        }
    )


def reading(
    position_rad: float,
    velocity_rad_s: float = 0.0,
    torque_nm: float = 0.0,
    motor_torque_ratio: float = 0.0,
    *,
    is_fd: bool = False,
) -> Reading:
    """Return the reading of a node that measured this; an overload beyond 327 N m."""
    measured = np.array([[position_rad], [velocity_rad_s], [torque_nm], [motor_torque_ratio]])
    return FieldScale([is_fd], 327.0).readings(measured[:, None])[0][0]
