"""Readings as devices send them, before any configuration: what a log of others contains."""

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from evidence.methods.sensed import Channels
from fsw.config import Config
from hil.world.inertia import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Readings:
    """N readings of each source; joints in the order of the configuration that is right."""

    t_joint_s: FloatArray  # (N,)
    t_torque_s: FloatArray  # (N,)
    t_imu_s: FloatArray  # (N,) of the true motion: group delays are left out
    position: FloatArray  # (N, n) [rad]
    torque: FloatArray  # (N, n) [N m]
    rate: FloatArray  # (N, 3) in S [rad/s]
    force: FloatArray  # (N, 3) in S [m/s2]

    def first(self, count: int) -> Self:
        """Return the first `count` readings of each source."""
        return replace(self, **{own.name: getattr(self, own.name)[:count] for own in fields(self)})


def sent(channels: Channels, right: Config) -> Readings:
    """Return the readings of devices that `right` describes: sign x (q + zero), sign x torque."""
    sign = np.array([joint.sign for joint in right.joints])
    zero = np.array([joint.zero_offset_rad for joint in right.joints])
    return Readings(
        t_joint_s=channels.t_s,
        t_torque_s=channels.t_s,
        t_imu_s=channels.t_s,
        position=sign * (channels.q_rad + zero),
        torque=sign * channels.tau_nm,
        rate=channels.w_NS_S_rad_s,
        force=channels.f_NS_S_m_s2,
    )


def read(readings: Readings, channels: Channels, right: Config, used: Config) -> Channels:
    """Return the channels as the configuration `used` reads the devices of `right`.

    A joint reads the node whose number it has. The time of an inertial sample is its arrival less
    the configured group delay, so that a wrong delay shifts the inertial samples.
    """
    t_s = channels.t_s
    positions, torques = by_joint(readings, right, used)
    sign = np.array([joint.sign for joint in used.joints])
    zero = np.array([joint.zero_offset_rad for joint in used.joints])
    gain = sign * np.array([joint.torque_gain for joint in used.joints])
    offset = np.array([joint.torque_offset_nm for joint in used.joints])
    imu_s = readings.t_imu_s - delay_s(right, used)
    return replace(
        channels,
        q_rad=_at(t_s, readings.t_joint_s, sign * positions - zero),
        tau_nm=_at(t_s, readings.t_torque_s, gain * torques - offset),
        w_NS_S_rad_s=_at(t_s, imu_s, readings.rate),
        f_NS_S_m_s2=_at(t_s, imu_s, readings.force),
    )


def by_joint(readings: Readings, right: Config, used: Config) -> tuple[FloatArray, FloatArray]:
    """Return positions and torques (N, n) in the order of the joints of `used`."""
    nodes = [joint.node_id for joint in right.joints]
    own = [nodes.index(joint.node_id) for joint in used.joints]
    return readings.position[:, own], readings.torque[:, own]


def delay_s(right: Config, used: Config) -> float:
    """Return the group delay that `used` has in excess of the right one."""
    return used.imu.gyro_group_delay_s - right.imu.gyro_group_delay_s


def _at(t_s: FloatArray, own_s: FloatArray, values: FloatArray) -> FloatArray:
    """Return columns at other times, interpolated; the same times give the same values."""
    if np.array_equal(t_s, own_s):
        return values
    return np.column_stack([np.interp(t_s, own_s, column) for column in values.T])
