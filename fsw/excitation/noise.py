"""Noise of the fused estimate per second of data, from the estimator's configuration.

Each channel's white noise is a density. The noise of qd and qdd is that of the polynomials that the
estimator fits in each window. The error covariances of a channel and of qdd at a window's nodes are
diagonalised together. If the Jacobian hardly changes within a window, the window's information is
the sum over the modes that a constant excites (the even ones).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from fsw.config import Config
from fsw.errors import ConfigError
from fsw.estimators.model.building import joint_order
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.polynomial import EXTRA_DEGREE, NodeFit
from fsw.messages import FloatArray

SMALLEST_SHARE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseModel:
    """Variances of one second of data [unit^2 s], and whether each nuisance is a state."""

    white: FloatArray  # (n + 6,) torque, accelerometer, gyro
    shares: FloatArray  # (k,) share of each mode in a constant, sums to 1
    joint_acceleration: FloatArray  # (k, n) variance of qdd in each mode
    joint_rate: FloatArray  # (n,) variance of qd
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
    shares, gains, rate_gain = _joint_modes(config, rates[joints[0].bus])
    position = np.array([joint.position_sigma_rad**2 / rates[joint.bus] for joint in joints])
    white = np.concatenate(
        (
            torque,
            np.full(3, imu.velocity_random_walk_m_s_sqrt_s**2),
            np.full(3, imu.angle_random_walk_rad_sqrt_s**2),
        )
    )
    return NoiseModel(
        white=white,
        shares=shares,
        joint_acceleration=np.outer(gains, position),
        joint_rate=rate_gain * position,
        p_BS_m=np.array(imu.mounting.p_BS_m),
        torque_offset=any(joint.torque_offset_sigma_nm for joint in joints),
        acc_bias=imu.acc_bias_sigma_m_s2 > 0,
        gyro_bias=imu.gyro_bias_sigma_rad_s > 0,
        momentum=config.estimator.momentum_sigma_nms > 0,
        torque_scale=any(joint.torque_scale_sigma_ratio for joint in joints),
    )


def _joint_modes(config: Config, rate_hz: float) -> tuple[FloatArray, FloatArray, float]:
    """Return shares and qdd gains (k,) of the modes, and the gain of qd's window mean.

    A gain is the variance density of the derivative for unit density of position noise.
    """
    estimator = config.estimator
    half_s, m = 0.5 * estimator.window_s, estimator.nodes
    count = max(round(estimator.window_s * rate_hz), m + EXTRA_DEGREE + 1)
    t_s = ((np.arange(count) + 0.5) / count * 2 - 1) * half_s
    channel = NodeFit(t_s, half_s, m - 1, m).covariance((0,), 1.0)
    position = NodeFit(t_s, half_s, m - 1 + EXTRA_DEGREE, m)
    gains, modes = eigh(position.covariance((2,), 1.0), channel)
    shares = modes.sum(axis=0) ** 2
    shares /= shares.sum()
    keep = shares > SMALLEST_SHARE
    rate = np.linalg.solve(position.covariance((1,), 1.0), np.ones(m)).sum()
    return shares[keep] / shares[keep].sum(), np.maximum(gains[keep], 0.0), count / float(rate)
