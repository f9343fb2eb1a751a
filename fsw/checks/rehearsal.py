"""One dry update, which shows whether estimation works with a configuration before its use.

Bounds of single values do not show whether the values suit each other. So this module builds
conditioner and online estimator as the loop does and gives them a window of gentle motion, twice:
the second update also does the background work that the first one has left.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from fsw.errors import ConfigError, unforeseen
from fsw.estimators.conditioning.blocks import build_conditioner
from fsw.estimators.effects.registered import DEVICES
from fsw.estimators.model.problem import Problem
from fsw.estimators.pipeline import Estimator
from fsw.estimators.recursive.online import build_online
from fsw.messages import ChannelWindow, Estimate, FloatArray, Window

SPEED_RAD_S, TORQUE_NM, RATE_RAD_S, FORCE_M_S2 = 0.05, 0.1, 1e-3, 1e-3


def rehearse(config: Config, problem: Problem) -> None:
    """Make one dry update with synthetic samples.

    Raises
    ------
    ConfigError when the update fails or resets the estimator, or the estimate is not finite.
    """
    try:
        with np.errstate(all="ignore"):
            estimator = build_online(config, problem.model)
            estimate = _update(config, problem, estimator)
    except (MemoryError, ConfigError):
        raise
    except Exception as error:
        raise ConfigError(f"a dry update fails: {unforeseen(error)}") from error
    reset = [text for _, code, text in estimator.events() if code == "ESTIMATOR_RESET"]
    if reset:
        raise ConfigError(f"a dry update fails: {reset[0]}")
    if not (np.isfinite(estimate.mean).all() and np.isfinite(estimate.covariance).all()):
        raise ConfigError("a dry update fails: the estimate is not finite")


def _update(config: Config, problem: Problem, estimator: Estimator) -> Estimate:
    block = build_conditioner(config, problem.model).condition(_window(config))
    if block is None:
        raise ConfigError("a dry update fails: a window of correct samples gives no block")
    estimator.push(block)
    return estimator.push(replace(block, index=block.index + 1))  # does the background work too


def _window(config: Config) -> Window:
    """Return a window with samples of all sensors, in which all that moves does so gently."""
    window_s = config.estimator.window_s
    rates = {bus.name: bus.rate_hz for bus in config.buses}
    joints = []
    for place, joint in enumerate(config.joints):
        t_s = _times_s(window_s, rates[joint.bus])
        angle = SPEED_RAD_S * t_s * (1.0 + 0.1 * place + t_s / window_s)
        if joint.speed_only:
            angle = SPEED_RAD_S * (1.0 + 0.1 * place + 2.0 * t_s / window_s)
        torque = TORQUE_NM * np.cos(t_s / window_s + place)
        joints.append(_channel(t_s, np.stack([angle, torque], axis=1)))
    t_s = _times_s(window_s, config.imu.rate_hz)
    turn = np.stack([np.sin(t_s / window_s + axis) for axis in range(3)], axis=1)
    still_s = np.array([0.5 * window_s] if config.star_tracker is not None else [])
    return Window(
        index=0,
        start_ns=0,
        stop_ns=round(window_s * 1e9),
        joints=tuple(joints),
        gyro=_channel(t_s, RATE_RAD_S * turn),
        accelerometer=_channel(t_s, FORCE_M_S2 * turn),
        attitude=_channel(still_s, np.tile([0.0, 0.0, 0.0, 1.0], (len(still_s), 1))),
        devices={
            kind.section: tuple(
                _channel(t_s, kind.gentle(own, t_s, window_s))
                for own in getattr(config, kind.section)
                for t_s in [_times_s(window_s, own.rate_hz)]
            )
            for kind in DEVICES
        },
    )


def _times_s(window_s: float, rate_hz: float) -> FloatArray:
    count = max(1, round(window_s * rate_hz))
    return np.asarray((np.arange(count) + 0.5) * (window_s / count), dtype=np.float64)


def _channel(t_s: FloatArray, values: FloatArray) -> ChannelWindow:
    t_ns: NDArray[np.int64] = np.rint(t_s * 1e9).astype(np.int64)
    return ChannelWindow(t_ns=t_ns, values=values, missing=not len(t_ns), stale=not len(t_ns))
