"""The newest sample of every channel as one record, laid out as the science packet has it.

The loop packs it; the service only puts headers around it. Order and types are those of
`fsw.telemetry.dictionary.housekeeping.SCIENCE_FIELDS` (a test compares), big-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from fsw.config.telemetry import JOINT_SLOTS
from fsw.messages import AttitudeSample, ImuSample, JointSample, Sample

_RECORD = struct.Struct(">4dH16d10dd")
_GYRO, _ACC, _ATTITUDE, _FIRST_JOINT = 0, 1, 2, 8


class Science:
    """Keeps the newest samples; tells which came since the last record."""

    def __init__(self) -> None:
        self._joints = [0.0] * (2 * JOINT_SLOTS)
        self._gyro: Sequence[float] = (0.0, 0.0, 0.0)
        self._acc: Sequence[float] = (0.0, 0.0, 0.0)
        self._attitude: Sequence[float] = (0.0, 0.0, 0.0, 0.0)
        self._times_ns = [0, 0, 0, 0]  # joint, gyro, accelerometer, attitude
        self._fresh = 0

    def keep(self, samples: Sequence[Sample]) -> None:
        """Remember what one source just gave."""
        for sample in samples:
            if isinstance(sample, JointSample):
                place = sample.joint
                if place < JOINT_SLOTS:
                    self._joints[2 * place] = sample.position_rad
                    if sample.torque_nm is not None:
                        self._joints[2 * place + 1] = sample.torque_nm
                    self._times_ns[0] = sample.t_ns
                    self._fresh |= 1 << (_FIRST_JOINT + place)
            elif isinstance(sample, ImuSample):
                self._keep_imu(sample)
            elif isinstance(sample, AttitudeSample):
                self._attitude = sample.q_NB_xyzw
                self._times_ns[3] = sample.t_ns
                self._fresh |= 1 << _ATTITUDE

    def _keep_imu(self, sample: ImuSample) -> None:
        if sample.w_NS_S_rad_s is not None:
            self._gyro = sample.w_NS_S_rad_s
            self._times_ns[1] = sample.t_gyro_ns
            self._fresh |= 1 << _GYRO
        if sample.f_NS_S_m_s2 is not None:
            self._acc = sample.f_NS_S_m_s2
            self._times_ns[2] = sample.t_acc_ns
            self._fresh |= 1 << _ACC

    def record(self, nis: float) -> bytes:
        """Return the record; `nis` of the newest window."""
        fresh, self._fresh = self._fresh, 0
        return _RECORD.pack(
            *(t_ns * 1e-9 for t_ns in self._times_ns),
            fresh,
            *self._joints,
            *self._gyro,
            *self._acc,
            *self._attitude,
            nis,
        )
