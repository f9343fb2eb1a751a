"""Errors of a force-torque sensor in the arm, axis by axis.

    measured = wrench (1 + scale) + offset

The wrench itself is predicted with the joint torques; see `model.wrench_sensor`.
"""

from collections.abc import Callable, Sequence

import numpy as np

from fsw.config import Config, WrenchSensorConfig
from fsw.estimators.effects.device import Device, Driven, Samples
from fsw.estimators.model.state_group import Setting, Spread, StateGroup
from fsw.estimators.model.wrench_sensor import AXES, WrenchSensor
from fsw.messages import FloatArray, IntArray


def sensors_of(config: Config) -> tuple[WrenchSensor, ...]:
    """Return the places of a configuration's sensors."""
    return tuple(
        WrenchSensor(
            name=own.name,
            key=f"wrench_sensors.{i}.frame",
            frame=own.frame,
            p_FS_m=own.p_FS_m,
            rpy_FS_rad=own.rpy_FS_rad,
        )
        for i, own in enumerate(config.wrench_sensors)
    )


def _swinging(own: WrenchSensorConfig, t_s: FloatArray, window_s: float) -> FloatArray:
    return np.asarray(0.1 * np.cos(t_s[:, None] / window_s + np.arange(len(own.noise))))


def _bearing(
    _own: WrenchSensorConfig, i: int, t_ns: IntArray, _span_ns: tuple[int, int], driven: Driven
) -> Samples:
    return t_ns, driven.wrench(i, np.asarray(t_ns * 1e-9, np.float64))


WRENCH_SENSORS = Device(section="wrench_sensors", gentle=_swinging, along=_bearing)


def _per_axis(
    sigmas: Callable[[WrenchSensorConfig], Sequence[float]],
) -> Callable[[Setting], Spread]:
    """Return the prior of one state for each axis."""

    def prior(setting: Setting) -> Spread:
        sensors = setting.config.wrench_sensors
        labels = [f"{sensor.name}.{axis}" for sensor in sensors for axis in AXES]
        return labels, [sigma for sensor in sensors for sigma in sigmas(sensor)]

    return prior


OFFSET = StateGroup(
    name="wrench_offset",
    effect="offsets of wrench sensors",
    unit="N, N m",
    key="wrench_sensors[].*_offset_*",
    prior=_per_axis(lambda own: [own.force_offset_sigma_n] * 3 + [own.torque_offset_sigma_nm] * 3),
)
SCALE = StateGroup(
    name="wrench_scale",
    effect="scales of wrench sensors",
    unit="",
    key="wrench_sensors[].scale_sigma_ratio",
    prior=_per_axis(lambda own: [own.scale_sigma_ratio] * 6),
    is_judged=True,
    is_repeated=True,
    shared=0.5,  # one calibration rig for all axes
    mistake="unit, axes or mounting of wrench sensors",
)
