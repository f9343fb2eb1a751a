"""Raw samples of a motion through the flight conditioner: the blocks that the daemon would make.

Channels are sampled at common times with any rate, and get white noise. The configuration declares
this noise and the length of the windows.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from fsw.config import Config
from fsw.estimators.conditioning.blocks import build_conditioner
from fsw.estimators.model.robot import RobotModel
from fsw.messages import Block, ChannelWindow, Window
from hil.world.history import TruthState
from hil.world.inertia import FloatArray
from hil.world.sensors import rotation_of, specific_force

LEAST = 1e-12  # least declared noise, because a zero noise has no finite weight


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelNoise:
    """1 sigma of the white noise of one sample of each channel."""

    position_rad: float
    torque_nm: float
    rate_rad_s: float
    acceleration_m_s2: float
    attitude_rad: float = 0.0
    shared: bool = False  # whether all channels have the same noise sequence


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlowChannel:
    """Samples of a wheel or a valve at separate times, in the form of `Window`."""

    t_s: FloatArray  # (k,) in ascending order
    values: FloatArray  # (k, 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Channels:
    """N samples of every raw channel at common times; slow channels have their own times."""

    t_s: FloatArray  # (N,)
    q_rad: FloatArray  # (N, n)
    tau_nm: FloatArray  # (N, n)
    w_NS_S_rad_s: FloatArray  # (N, 3)
    f_NS_S_m_s2: FloatArray  # (N, 3) at the accelerometer
    R_NB: FloatArray  # (N, 3, 3)
    wheels: tuple[SlowChannel, ...] = ()
    thrusters: tuple[SlowChannel, ...] = ()


def sensed(state: TruthState, config: Config) -> Channels:
    """Return the samples of error-free sensors that are mounted as configured."""
    mounting = config.imu.mounting
    px, py, pz = mounting.p_BS_m
    qx, qy, qz, qw = mounting.q_BS_xyzw
    R_BS = rotation_of((qx, qy, qz, qw))
    return Channels(
        t_s=state.t_s,
        q_rad=state.q,
        tau_nm=state.tau,
        w_NS_S_rad_s=state.w_NB_B @ R_BS,
        f_NS_S_m_s2=specific_force(state, (px, py, pz), R_BS),
        R_NB=state.R_NB,
    )


def draws(count: int, n: int, rng: np.random.Generator, *, shared: bool) -> dict[str, FloatArray]:
    """Return standard normal draws (count, k) by channel; `shared`: the same on every axis."""
    widths = {
        "position": n,
        "torque": n,
        "rate": 3,
        "acceleration": 3,
        "velocity": 3,
        "attitude": 3,
    }
    if shared:
        one = rng.standard_normal((count, 1))
        return {name: np.repeat(one, width, axis=1) for name, width in widths.items()}
    return {name: rng.standard_normal((count, width)) for name, width in widths.items()}


def faded(white: FloatArray, fading: float) -> FloatArray:
    """Return noise (k, n) of equal variance; `fading` is the correlation of adjacent samples."""
    from scipy.signal import lfilter

    fresh = white * np.sqrt(1.0 - fading**2)
    fresh[0] = white[0]
    return np.asarray(lfilter([1.0], [1.0, -fading], fresh, axis=0))


def with_noise(exact: Channels, noise: ChannelNoise, unit: Mapping[str, FloatArray]) -> Channels:
    """Return the channels plus the noise times the unit draws."""
    turned = Rotation.from_rotvec(noise.attitude_rad * unit["attitude"]).as_matrix()
    return replace(
        exact,
        q_rad=exact.q_rad + noise.position_rad * unit["position"],
        tau_nm=exact.tau_nm + noise.torque_nm * unit["torque"],
        w_NS_S_rad_s=exact.w_NS_S_rad_s + noise.rate_rad_s * unit["rate"],
        f_NS_S_m_s2=exact.f_NS_S_m_s2 + noise.acceleration_m_s2 * unit["acceleration"],
        R_NB=exact.R_NB @ turned,
    )


def with_biases(channels: Channels, config: Config, rng: np.random.Generator) -> Channels:
    """Return the channels plus torque offsets and inertial biases, drawn from their priors."""
    offsets = np.array([joint.torque_offset_sigma_nm for joint in config.joints])
    gyro, acc = config.imu.gyro_bias_sigma_rad_s, config.imu.acc_bias_sigma_m_s2
    return replace(
        channels,
        tau_nm=channels.tau_nm + offsets * rng.standard_normal(len(offsets)),
        w_NS_S_rad_s=channels.w_NS_S_rad_s + gyro * rng.standard_normal(3),
        f_NS_S_m_s2=channels.f_NS_S_m_s2 + acc * rng.standard_normal(3),
    )


def declared(
    config: Config,
    noise: ChannelNoise,
    rate_hz: float,
    *,
    window_s: float | None = None,
    nodes: int | None = None,
) -> Config:
    """Return the configuration with this noise and rate; None keeps its value of the window."""
    joints = tuple(
        joint.model_copy(
            update={
                "position_noise_rad": max(noise.position_rad, LEAST),
                "torque_noise_nm": max(noise.torque_nm, LEAST),
            }
        )
        for joint in config.joints
    )
    imu = config.imu.model_copy(
        update={
            "rate_hz": rate_hz,
            "angle_random_walk_rad_sqrt_s": max(noise.rate_rad_s, LEAST) / rate_hz**0.5,
            "velocity_random_walk_m_s_sqrt_s": max(noise.acceleration_m_s2, LEAST) / rate_hz**0.5,
        }
    )
    windows = {"window_s": window_s, "nodes": nodes}
    estimator = config.estimator.model_copy(
        update={name: value for name, value in windows.items() if value is not None}
    )
    buses = tuple(bus.model_copy(update={"rate_hz": rate_hz}) for bus in config.buses)
    update = {"joints": joints, "imu": imu, "estimator": estimator, "buses": buses}
    return config.model_copy(update=update)


def condition(channels: Channels, config: Config, rate_hz: float) -> list[Block]:
    """Return the blocks of the flight conditioner; a rejected window gives no block."""
    model = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
    conditioner = build_conditioner(config, model)
    blocks = map(conditioner.condition, _windows(channels, config.estimator.window_s, rate_hz))
    return [block for block in blocks if block is not None]


def _windows(channels: Channels, window_s: float, rate_hz: float) -> Iterator[Window]:
    """Yield whole windows; the first one begins half a period before the first sample."""
    size, width_ns = round(window_s * rate_hz), round(window_s * 1e9)
    t_ns = np.rint(channels.t_s * 1e9).astype(np.int64)
    q_xyzw = Rotation.from_matrix(channels.R_NB).as_quat()
    first_ns = int(t_ns[0]) - round(0.5e9 / rate_hz)
    for index in range(len(t_ns) // size):
        k = slice(index * size, (index + 1) * size)

        def channel(values: FloatArray, k: slice = k) -> ChannelWindow:
            return ChannelWindow(t_ns=t_ns[k], values=values[k], missing=False, stale=False)

        start_ns = first_ns + index * width_ns
        stop_ns = start_ns + width_ns
        yield Window(
            index=index,
            start_ns=start_ns,
            stop_ns=stop_ns,
            joints=tuple(
                channel(np.stack([channels.q_rad[:, j], channels.tau_nm[:, j]], axis=1))
                for j in range(channels.q_rad.shape[1])
            ),
            gyro=channel(channels.w_NS_S_rad_s),
            accelerometer=channel(channels.f_NS_S_m_s2),
            attitude=channel(q_xyzw),
            devices={
                section: tuple(_within(channel, start_ns, stop_ns) for channel in own)
                for section, own in (("wheels", channels.wheels), ("thrusters", channels.thrusters))
            },
        )


def _within(channel: SlowChannel, start_ns: int, stop_ns: int) -> ChannelWindow:
    t_ns = np.rint(channel.t_s * 1e9).astype(np.int64)
    k = slice(*np.searchsorted(t_ns, [start_ns, stop_ns]).tolist())
    is_empty = k.start == k.stop
    return ChannelWindow(t_ns=t_ns[k], values=channel.values[k], missing=is_empty, stale=is_empty)
