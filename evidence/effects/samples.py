"""Samples of a scenario's sensors: exact along one truth, then with the noise of a seed.

Joints and inertial unit are sampled at the bus's rate, wheels and valves at their own rates. Every
sample has an attitude with the star tracker's noise. No device, byte or clock is simulated.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from evidence.methods.sensed import (
    ChannelNoise,
    Channels,
    SlowChannel,
    draws,
    sensed,
    with_biases,
    with_noise,
)
from fsw.config import Config
from hil.run.bench import robot_of, truth_of
from hil.world.history import TruthHistory
from hil.world.inertia import FloatArray
from hil.world.scenario import Scenario, load
from hil.world.sensor_config import SensorConfig
from hil.world.spline import JointSpline
from hil.world.thrusters import ThrusterSystem

STREAM = 139  # spawn key of the samples' noise and biases


@lru_cache(maxsize=1)
def truth(name: str) -> tuple[TruthHistory, float]:
    """Return the truth of a scenario, equal for all seeds, and the duration of its motion [s]."""
    scenario = load(name)
    spline = JointSpline.load(scenario.identification)
    return truth_of(scenario, robot_of(scenario), spline), spline.duration_s


def rate_hz(scenario: Scenario) -> float:
    """Return the sample rate of joints and inertial unit [Hz]."""
    return float(scenario.flight["bus"]["rate_hz"])


def exact(name: str, config: Config) -> Channels:
    """Return the samples of error-free sensors along the motion of a scenario."""
    scenario, (history, duration_s) = load(name), truth(name)
    sensors = SensorConfig.from_dict(scenario.sensors)
    state = history.at(_times(duration_s, rate_hz(scenario)))
    wheels: tuple[SlowChannel, ...] = ()
    if scenario.wheels is not None and sensors.wheels is not None:
        t_s = _times(duration_s, sensors.wheels.rate_hz)
        speed = np.stack([history.wheels_at(t)[0] for t in t_s.tolist()])
        wheels = tuple(
            SlowChannel(t_s=t_s, values=np.stack([own, np.full(len(own), np.nan)], axis=1))
            for own in speed.T
        )
    thrusters: tuple[SlowChannel, ...] = ()
    if scenario.thrusters is not None and sensors.thrusters is not None:
        t_s = _times(duration_s, sensors.thrusters.rate_hz)
        thrusters = _valves(scenario.thrusters, t_s)
    return replace(sensed(state, config), wheels=wheels, thrusters=thrusters)


def noisy(channels: Channels, config: Config, seed: int) -> Channels:
    """Return the samples with white noise and biases, drawn from the sigmas of a configuration."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM,)))
    unit = draws(len(channels.t_s), channels.q_rad.shape[1], rng, shared=False)
    found = with_biases(with_noise(channels, _noise(config), unit), config, rng)
    sigmas = [[wheel.speed_noise_rad_s, 0.0] for wheel in config.wheels]
    wheels = [
        replace(own, values=own.values + sigma * rng.standard_normal(own.values.shape))
        for own, sigma in zip(channels.wheels, np.array(sigmas), strict=True)
    ]
    return replace(found, wheels=tuple(wheels))


def _noise(config: Config) -> ChannelNoise:
    """Return the declared white noise; the noise of the first joint is used for all joints."""
    joint, imu, tracker = config.joints[0], config.imu, config.star_tracker
    root = imu.rate_hz**0.5
    return ChannelNoise(
        position_rad=joint.position_noise_rad,
        torque_nm=joint.torque_noise_nm,
        rate_rad_s=imu.angle_random_walk_rad_sqrt_s * root,
        acceleration_m_s2=imu.velocity_random_walk_m_s_sqrt_s * root,
        attitude_rad=0.0 if tracker is None else tracker.noise_about_rad,
    )


def _valves(system: ThrusterSystem, t_s: FloatArray) -> tuple[SlowChannel, ...]:
    """Return rows (state, 1 if a change) of each valve at periodic reports and reported changes."""
    reports = np.array([system.valves_at(t)[0] for t in t_s.tolist()], dtype=np.float64)
    found = []
    for jet, state in enumerate(reports.T):
        edges = [
            (at_s, is_open, 1.0)
            for pulse in system.pulses
            if pulse.jet == jet and pulse.reported
            for at_s, is_open in ((pulse.on_s, 1.0), (pulse.on_s + pulse.for_s, 0.0))
        ]
        rows = [*edges, *zip(t_s.tolist(), state.tolist(), np.zeros(len(t_s)), strict=True)]
        ordered = np.array(sorted(rows, key=lambda row: (row[0], -row[2])))  # a change comes first
        found.append(SlowChannel(t_s=ordered[:, 0], values=ordered[:, 1:]))
    return tuple(found)


def _times(duration_s: float, rate_hz: float) -> FloatArray:
    return np.arange(round(duration_s * rate_hz)) / rate_hz
