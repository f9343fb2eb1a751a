"""Inertial unit and star tracker whose frames a description gives: frames to timed samples."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.config import BusConfig, HealthConfig, ImuConfig, StarTrackerConfig
from fsw.config.constants import STANDARD_GRAVITY_M_S2
from fsw.drivers.layout.joints import FIRST, Layout, Use
from fsw.drivers.sources.device_reports import Reporter, Reports
from fsw.drivers.sources.line_watch import IMU_LINE, TRACKER_LINE, LineFaults
from fsw.drivers.sources.samples import SampleSource, attitude_samples, imu_samples
from fsw.drivers.wire import FrameArray, Reject
from fsw.messages import Samples
from fsw.messages.findings import Fault

FINE_RATIO = 0.01  # of the noise: three equal vectors of larger steps may be chance
FLOAT_STEPS = 2**15  # least steps of a converter behind a float, from zero to the unit's range


@dataclass(frozen=True, slots=True, kw_only=True)
class _Kind:
    """One kind of sensor.

    Attributes
    ----------
    samples : makes the source whose `build` calibrates and judges values
    clusters, width : faults of values that are missing together, and how many they are
    line, refused : faults of its line, and of samples with a bad status or value
    """

    samples: Callable[[Any], SampleSource]
    clusters: tuple[Fault, ...]
    width: int
    line: LineFaults
    refused: Mapping[Reject, Fault]


_KINDS = {
    "imu": _Kind(
        samples=imu_samples,
        clusters=(Fault.GYRO_FAULT, Fault.ACC_FAULT),
        width=3,
        line=IMU_LINE,
        refused={Reject.STATUS: Fault.GYRO_FAULT, Reject.RANGE: Fault.IMU_RANGE},
    ),
    "star_tracker": _Kind(
        samples=attitude_samples,
        clusters=(Fault.TRACKER_BLIND,),
        width=4,
        line=TRACKER_LINE,
        refused={Reject.STATUS: Fault.TRACKER_BLIND, Reject.RANGE: Fault.TRACKER_RANGE},
    ),
}


def _is_fine(config: ImuConfig, layout: Layout) -> bool:
    """Return whether noise hides the steps of the wire, so that equal readings are a fault."""
    root, most_m_s2 = config.rate_hz**0.5, config.acc_range_g * STANDARD_GRAVITY_M_S2
    gyro = config.angle_random_walk_rad_sqrt_s * root, config.max_rate_rad_s
    accelerometer = config.velocity_random_walk_m_s_sqrt_s * root, most_m_s2
    values = sorted((use for use in layout.uses if use.role >= FIRST), key=lambda use: use.role)
    limits = [*[gyro] * 3, *[accelerometer] * 3]
    return all(
        _step(use, most) <= FINE_RATIO * sigma
        for use, (sigma, most) in zip(values, limits, strict=True)
    )


def _step(use: Use, most: float) -> float:
    """Return the step of a value whose largest one is `most`."""
    if use.signal.number == "float":
        return most / FLOAT_STEPS
    return abs(use.signal.scale * use.factor)


class SensorBusSource:
    """The inertial unit or the star tracker of one bus.

    Samples are timed like those of a described joint, and calibrated like those of a feed.
    `is_screened`: whether equal readings in a row show that the device is stuck.
    """

    def __init__(
        self,
        bus: BusConfig,
        config: ImuConfig | StarTrackerConfig,
        layout: Layout,
        health: HealthConfig,
    ) -> None:
        self.kind = config.name
        own = _KINDS[self.kind]
        self._source, self._clusters = own.samples(config), own.clusters
        self._shape = (len(own.clusters), own.width)
        self.is_screened = isinstance(config, ImuConfig) and _is_fine(config, layout)
        reporter = Reporter(config.name, config.rate_hz, layout, config.node_id)
        self._reports = Reports(bus, [reporter], own.line, own.refused, health.silent_periods)
        self.words, self.owns = self._reports.words, self._reports.owns
        self.watch, self.findings = self._reports.watch, self._reports.findings

    @property
    def counters(self) -> dict[str, int]:
        """Counts of accepted and rejected samples, by name."""
        return self._reports.counters

    def feed(self, frames: FrameArray) -> Samples:
        """Accept frames in order, SYNCs among them, and return the samples they hold."""
        timed, build = self._reports.read(frames), self._source.build
        count, width = self._shape
        read = timed.values[:, FIRST : FIRST + count * width].reshape(-1, count, width)
        is_whole: NDArray[np.bool_] = np.all(np.isfinite(read), axis=2)
        values = np.where(is_whole[:, :, None], read, np.nan).reshape(len(read), count * width)
        is_some: NDArray[np.bool_] = np.any(is_whole, axis=1)
        index = np.arange(len(read))
        in_range = np.isin(index, build(timed.t_ns, index, values).t_receive_ns)
        rows = self._reports.good(timed, is_some, in_range)
        for row in rows[~is_whole[rows].all(axis=1)].tolist():
            for cluster in np.flatnonzero(~is_whole[row]).tolist():
                fault = self._clusters[cluster]
                self._reports.find(0, int(timed.done_ns[row]), fault, "no usable value")
        return build(timed.t_ns[rows], timed.done_ns[rows], values[rows])
