"""Sensors that repeat themselves: a live one has noise, so equal readings in a row give it away.

The difference of two readings of a channel with white noise of sigma s, rounded to steps of q, is
zero with probability below q / (s sqrt(2 pi)); k equal readings in a row are then less likely than
that to the power k - 1. The bound is taken for a sensor three times quieter than declared.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from fsw.config import Config
from fsw.messages import ImuSample, JointSample, Sample
from fsw.messages.findings import Fault, Finding

FALSE_ALARM = 1e-12  # per sample
QUIETER = 3.0
TORQUE_STEP_NM: Mapping[str, float] = {"classic": 1e-2, "fd": 1e-4}
CLUSTER_SAMPLES = 3  # equal vectors of three noisy 24-bit readings: below 1e-12 for any real unit
REPEAT_NS = 100_000_000  # what is still stuck is reported again after so long


def equal_readings(step: float, sigma: float) -> int:
    """Return how many equal readings in a row no live sensor gives; 0: it may be that quiet."""
    chance = QUIETER * step / (sigma * math.sqrt(2.0 * math.pi))
    if chance > 0.5:
        return 0
    return 1 + math.ceil(math.log(FALSE_ALARM) / math.log(chance))


class _Run:
    """Equal readings in a row of one channel."""

    __slots__ = ("_told_ns", "count", "limit", "newest")

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.count = 0
        self.newest: object = None
        self._told_ns: int | None = None

    def add(self, reading: object) -> bool:
        """Accept a reading; True while the channel is stuck."""
        if reading != self.newest:
            self.newest, self.count, self._told_ns = reading, 1, None
            return False
        self.count += 1
        return bool(self.limit) and self.count >= self.limit

    def is_to_be_told(self, t_ns: int) -> bool:
        """Return whether a report is due: newly stuck, or stuck for long since the last report."""
        if self._told_ns is not None and t_ns - self._told_ns < REPEAT_NS:
            return False
        self._told_ns = t_ns
        return True


class StuckScreen:
    """Takes stuck torques, rates and forces out of samples."""

    def __init__(self, config: Config) -> None:
        self._joints = [joint.name for joint in config.joints]
        self._torque = [
            _Run(equal_readings(j.torque_gain * TORQUE_STEP_NM[j.format], j.torque_noise_nm))
            for j in config.joints
        ]
        self._gyro, self._acc = _Run(CLUSTER_SAMPLES), _Run(CLUSTER_SAMPLES)
        self._found: list[Finding] = []

    def take(self) -> list[Finding]:
        """Return and forget what was found."""
        found, self._found = self._found, []
        return found

    def screen(self, sample: Sample) -> Sample:
        """Return the sample without its stuck values."""
        if isinstance(sample, JointSample):
            torque = sample.torque_nm
            if torque is None:
                return sample
            run = self._torque[sample.joint]
            if not run.add(torque):
                return sample
            self._tell(run, sample.t_receive_ns, Fault.TORQUE_STUCK, self._joints[sample.joint])
            return replace(sample, torque_nm=None)
        if isinstance(sample, ImuSample):
            return self._inertial(sample)
        return sample

    def _inertial(self, sample: ImuSample) -> ImuSample:
        rate, force = sample.w_NS_S_rad_s, sample.f_NS_S_m_s2
        if rate is not None and self._gyro.add(rate):
            self._tell(self._gyro, sample.t_receive_ns, Fault.GYRO_STUCK, "gyro")
            sample = replace(sample, w_NS_S_rad_s=None)
        if force is not None and self._acc.add(force):
            self._tell(self._acc, sample.t_receive_ns, Fault.ACC_STUCK, "accelerometer")
            sample = replace(sample, f_NS_S_m_s2=None)
        return sample

    def _tell(self, run: _Run, t_ns: int, fault: Fault, subject: str) -> None:
        if run.is_to_be_told(t_ns):
            self._found.append(Finding(t_ns, fault, subject, f"{run.count} equal readings"))
