"""Noise of the fused estimate per second of data, from the estimator's configuration.

Each channel's white noise is a density. Noise of the joints' positions is left out: the estimator
joins the motion from window to window, so that the sensors alone determine what a motion shows.
"""

from dataclasses import dataclass

import numpy as np

from fsw.config import Config
from fsw.errors import ConfigError
from fsw.estimators.model.building import joint_order
from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseModel:
    """Variances of one second of data [unit^2 s], and whether each nuisance is a state."""

    white: FloatArray  # (n + 6,) torque, accelerometer, gyro
    p_BS_m: FloatArray  # (3,)
    torque_offset: bool
    acc_bias: bool
    gyro_bias: bool
    momentum: bool
    torque_scale: bool


def noise_model(config: Config, model: RobotModel) -> NoiseModel:
    """Return the noise of a configuration, joints in the robot model's order.

    Raises
    ------
    ConfigError for a joint that measures its speed only.
    """
    joints = [config.joints[k] for k in joint_order(config, model)]
    turning = [joint.name for joint in joints if joint.speed_only]
    if turning:
        raise ConfigError(
            f"joints: {turning[0]!r} has encoder: speed; a motion is planned by positions only"
        )
    rates = {bus.name: bus.rate_hz for bus in config.buses}
    imu = config.imu
    torque = [joint.torque_noise_nm**2 / rates[joint.bus] for joint in joints]
    white = np.concatenate(
        (
            torque,
            np.full(3, imu.velocity_random_walk_m_s_sqrt_s**2),
            np.full(3, imu.angle_random_walk_rad_sqrt_s**2),
        )
    )
    return NoiseModel(
        white=white,
        p_BS_m=np.array(imu.mounting.p_BS_m),
        torque_offset=any(joint.torque_offset_sigma_nm for joint in joints),
        acc_bias=imu.acc_bias_sigma_m_s2 > 0,
        gyro_bias=imu.gyro_bias_sigma_rad_s > 0,
        momentum=config.estimator.momentum_sigma_nms > 0,
        torque_scale=any(joint.torque_scale_sigma_ratio for joint in joints),
    )
