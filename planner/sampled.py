"""The noise-free samples that the devices would give along a motion, as blocks of windows."""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from fsw.config import Config
from fsw.estimators.conditioning.blocks import build_conditioner
from fsw.estimators.conditioning.rotation import rotation_from_xyzw
from fsw.estimators.effects.device import Device, Driven
from fsw.estimators.effects.registered import DEVICES
from fsw.estimators.model.building import joint_order
from fsw.estimators.model.robot import RobotModel
from fsw.messages import Block, ChannelWindow, FloatArray, IntArray, Window
from planner import attitude
from planner.firings import by_device
from planner.spline import Trajectory

Signals = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]


def sampled_blocks(
    config: Config, model: RobotModel, trajectory: Trajectory, signals: Signals
) -> list[Block]:
    """Return the blocks of all whole windows of a motion; unusable windows are left out.

    `signals` returns for times (m,) [s] the torques (m, t) [N m], the base's rate [rad/s] and
    the inertial unit's specific force [m/s^2], both (m, 3) in B.
    """
    window_ns = round(config.estimator.window_s * 1e9)
    start = np.argsort(joint_order(config, model))
    joints = tuple(
        joint.model_copy(update={"start_rad": float(trajectory.points_rad[0, k])})
        if joint.speed_only
        else joint
        for joint, k in zip(config.joints, start, strict=True)
    )
    conditioner = build_conditioner(config.model_copy(update={"joints": joints}), model)
    windows = _Windows(config, model, trajectory, signals)
    count = int(trajectory.duration_s * 1e9 + 1) // window_ns
    blocks = (conditioner.condition(windows.at(k, window_ns)) for k in range(count))
    return [block for block in blocks if block is not None]


class _Windows:
    """Noise-free samples of every sensor along a motion."""

    def __init__(
        self, config: Config, model: RobotModel, trajectory: Trajectory, signals: Signals
    ) -> None:
        self._config, self._trajectory, self._signals = config, trajectory, signals
        self._own = np.argsort(joint_order(config, model))  # model index of each configured joint
        self._R_BS = rotation_from_xyzw(np.array(config.imu.mounting.q_BS_xyzw))
        count = max(int(np.ceil(trajectory.duration_s * config.imu.rate_hz)), 1)
        step_s = trajectory.duration_s / count
        w = signals(step_s * np.arange(0.5, count))[1]
        self._driven = Driven(wrench=self._wrench, firings=by_device(trajectory.firings))
        self._R_NB, self._step_s = attitude.attitudes(w, step_s), step_s

    def at(self, index: int, window_ns: int) -> Window:
        config, start_ns = self._config, index * window_ns
        rates = {bus.name: bus.rate_hz for bus in config.buses}
        joints = []
        found = {name: self._arm(start_ns, window_ns, rate) for name, rate in rates.items()}
        for joint, k in zip(config.joints, self._own, strict=True):
            t_ns, q, qd, tau = found[joint.bus]
            torque = tau[:, k] if joint.torque != "none" else np.full(len(t_ns), np.nan)
            own = (qd if joint.speed_only else q)[:, k]
            joints.append(_channel(t_ns, np.stack([own, torque], axis=1)))
        imu_rate_hz = config.imu.rate_hz if config.imu.present else 0.0
        t_ns = _times(start_ns, window_ns, imu_rate_hz)
        _, w, f = self._signals(_seconds(t_ns))
        return Window(
            index=index,
            start_ns=start_ns,
            stop_ns=start_ns + window_ns,
            joints=tuple(joints),
            gyro=_channel(t_ns, w @ self._R_BS),
            accelerometer=_channel(t_ns, f @ self._R_BS),
            attitude=self._attitude(start_ns, window_ns),
            devices={kind.section: self._reports(kind, start_ns, window_ns) for kind in DEVICES},
        )

    def _reports(self, kind: Device, start_ns: int, window_ns: int) -> tuple[ChannelWindow, ...]:
        span_ns, found = (start_ns, start_ns + window_ns), []
        for i, own in enumerate(getattr(self._config, kind.section)):
            t_ns = _times(start_ns, window_ns, own.rate_hz)
            found.append(_channel(*kind.along(own, i, t_ns, span_ns, self._driven)))
        return tuple(found)

    def _wrench(self, sensor: int, t_s: FloatArray) -> FloatArray:
        first = len(self._own) + 6 * sensor
        return self._signals(t_s)[0][:, first : first + 6]

    def _arm(
        self, start_ns: int, window_ns: int, rate_hz: float
    ) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        t_ns = _times(start_ns, window_ns, rate_hz)
        t_s = _seconds(t_ns)
        q, qd = self._trajectory.evaluate(t_s)[:2]
        return t_ns, q, qd, self._signals(t_s)[0]

    def _attitude(self, start_ns: int, window_ns: int) -> ChannelWindow:
        if self._config.star_tracker is None:
            return _channel(np.empty(0, np.int64), np.empty((0, 4)))
        t_ns = _times(start_ns, window_ns, self._config.star_tracker.rate_hz)
        steps = np.minimum((t_ns * 1e-9 / self._step_s).astype(np.intp), len(self._R_NB) - 1)
        return _channel(t_ns, Rotation.from_matrix(self._R_NB[steps]).as_quat())


def _times(start_ns: int, window_ns: int, rate_hz: float) -> IntArray:
    """Return the times [ns] of a device's samples in a window, on one grid for all windows."""
    if not rate_hz:
        return np.empty(0, np.int64)
    period_ns = 1e9 / rate_hz
    first = int(np.ceil(start_ns / period_ns - 0.5))
    last = int(np.ceil((start_ns + window_ns) / period_ns - 0.5))
    return np.asarray(np.rint((np.arange(first, last) + 0.5) * period_ns), dtype=np.int64)


def _seconds(t_ns: IntArray) -> FloatArray:
    return np.asarray(t_ns * 1e-9, dtype=np.float64)


def _channel(t_ns: IntArray, values: FloatArray) -> ChannelWindow:
    return ChannelWindow(t_ns=t_ns, values=values, missing=not len(t_ns), stale=not len(t_ns))
