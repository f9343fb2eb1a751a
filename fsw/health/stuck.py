"""Detection of stuck sensors: a working sensor has noise, so equal readings in a row show a fault.

The difference of two readings of a channel with white noise of sigma s, rounded to steps of q, is
zero with probability below q / (s sqrt(2 pi)); k equal readings in a row are then less likely than
that to the power k - 1. The bound assumes a sensor three times quieter than configured.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from fsw.config.joints import TORQUE_STEP_NM
from fsw.messages import FloatArray, ImuSamples, IntArray, JointSamples, Samples
from fsw.messages.false_alarms import per_test
from fsw.messages.findings import Fault, Finding

FALSE_ALARM = per_test("health")  # probability per sample
QUIETER = 3.0
CLUSTER_SAMPLES = 3  # equal vectors of three noisy 24-bit readings: below 1e-12 for any real unit
NEVER = 1 << 62
REPEAT_NS = 100_000_000  # a sensor that is still stuck is reported again after this time


def equal_readings(step: float, sigma: float) -> int:
    """Return how many equal readings in a row show a stuck sensor; 0: no number does."""
    chance = QUIETER * step / (sigma * math.sqrt(2.0 * math.pi))
    if chance > 0.5:
        return 0
    return 1 + math.ceil(math.log(FALSE_ALARM) / math.log(chance))


class _Runs:
    """Counts equal readings in a row of channels of one kind, across batches."""

    def __init__(self, limits: Sequence[int], width: int) -> None:
        self._limits = np.array([limit or NEVER for limit in limits])
        self._newest = np.full((len(limits), width), np.nan)
        self._counts = np.zeros(len(limits), np.int64)
        self._reported_ns: dict[int, int] = {}

    def stuck(self, channel: IntArray, readings: FloatArray) -> IntArray:
        """Accept readings (k, width) of channels (k,), sorted by channel.

        Returns
        -------
        (k,) number of equal readings up to each reading, 0 where the channel is not stuck.
        """
        size = len(readings)
        first = np.ones(size, np.bool_)
        first[1:] = channel[1:] != channel[:-1]
        heads = np.flatnonzero(first)
        before = np.empty_like(readings)
        before[1:] = readings[:-1]
        before[heads] = self._newest[channel[heads]]
        same = (readings == before).all(axis=1)
        tails = np.append(heads[1:], size) - 1
        if not np.count_nonzero(same):
            self._newest[channel[tails]], self._counts[channel[tails]] = readings[tails], 1
            return np.zeros(size, np.int64)
        place = np.arange(size)
        start = np.maximum.accumulate(np.where(first | ~same, place, 0))
        counts = place - start + 1
        counts += np.where(same[start], self._counts[channel], 0)  # runs of the batch before
        self._newest[channel[tails]], self._counts[channel[tails]] = readings[tails], counts[tails]
        return np.where(counts >= self._limits[channel], counts, 0)

    def reports(
        self, channel: IntArray, counts: IntArray, t_ns: IntArray
    ) -> Iterator[tuple[int, int, int]]:
        """Yield channel, time and length of runs: when newly stuck, then every `REPEAT_NS`."""
        if not (self._reported_ns or np.count_nonzero(counts)):
            return
        rows = zip(channel.tolist(), counts.tolist(), t_ns.tolist(), strict=True)
        for owner, count, time_ns in rows:
            if not count:
                self._reported_ns.pop(owner, None)
            elif time_ns - self._reported_ns.get(owner, -REPEAT_NS) >= REPEAT_NS:
                self._reported_ns[owner] = time_ns
                yield owner, time_ns, count


class StuckScreen:
    """Replaces stuck torques, rates and specific forces in samples by NaN."""

    def __init__(self, config: Config, torque_steps_nm: Sequence[float] = ()) -> None:
        """`torque_steps_nm`: resolution of every joint's torque; empty: those of canopen nodes."""
        steps = torque_steps_nm or [TORQUE_STEP_NM[joint.format] for joint in config.joints]
        self._joints = [joint.name for joint in config.joints]
        limits = [
            equal_readings(abs(j.torque_gain) * step, j.torque_noise_nm)
            for j, step in zip(config.joints, steps, strict=True)
        ]
        self._torque = _Runs(limits, 1)
        self._gyro, self._acc = _Runs([CLUSTER_SAMPLES], 3), _Runs([CLUSTER_SAMPLES], 3)
        self._found: list[Finding] = []

    def take(self) -> list[Finding]:
        """Return the findings since the last call."""
        found, self._found = self._found, []
        return found

    def screen(self, samples: Samples) -> Samples:
        """Return the samples with their stuck values replaced by NaN."""
        received_ns = samples.t_receive_ns
        if isinstance(samples, JointSamples):
            torque = samples.torque_nm[:, None]
            stuck = self._look(
                self._torque, samples.joint, torque, received_ns, Fault.TORQUE_STUCK, self._joints
            )
            if not np.count_nonzero(stuck):
                return samples
            return replace(samples, torque_nm=np.where(stuck, np.nan, samples.torque_nm))
        if isinstance(samples, ImuSamples):
            only = np.zeros(len(samples), np.int64)
            rate, force = samples.w_NS_S_rad_s, samples.f_NS_S_m_s2
            gyro = self._look(self._gyro, only, rate, received_ns, Fault.GYRO_STUCK, ["gyro"])
            acc = self._look(
                self._acc, only, force, received_ns, Fault.ACC_STUCK, ["accelerometer"]
            )
            if not np.count_nonzero(gyro | acc):
                return samples
            return replace(
                samples,
                w_NS_S_rad_s=np.where(gyro[:, None], np.nan, rate),
                f_NS_S_m_s2=np.where(acc[:, None], np.nan, force),
            )
        return samples

    def _look(
        self,
        runs: _Runs,
        channel: IntArray,
        values: FloatArray,
        t_ns: IntArray,
        fault: Fault,
        subjects: Sequence[str],
    ) -> NDArray[np.bool_]:
        """Return (k,) which values are stuck, and keep the findings."""
        stuck = np.zeros(len(values), np.bool_)
        usable = np.flatnonzero(~np.isnan(values[:, 0]))
        order = usable[np.argsort(channel[usable], kind="stable")]
        if order.size:
            counts = runs.stuck(channel[order], values[order])
            stuck[order] = counts > 0
            for owner, time_ns, count in runs.reports(channel[order], counts, t_ns[order]):
                text = f"{count} equal readings"
                self._found.append(Finding(time_ns, fault, subjects[owner], text))
        return stuck
