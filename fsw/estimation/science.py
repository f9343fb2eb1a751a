"""The newest sample of every channel as one record, in the layout of the science packet.

The estimation packs the record; the service only adds headers. Order and types are those of
`fsw.telemetry.dictionary.housekeeping.SCIENCE_FIELDS` (a test compares them), big-endian.
"""

import math
import struct
from collections.abc import Sequence

import numpy as np

from fsw.config.telemetry import JOINT_SLOTS
from fsw.messages import AttitudeSamples, FloatArray, ImuSamples, IntArray, JointSamples, Samples

_RECORD = struct.Struct(">4dH16d10dd")
_GYRO, _ACC, _ATTITUDE, _FIRST_JOINT = 0, 1, 2, 8


class Science:
    """Keeps the newest samples, and marks those that came since the last record."""

    def __init__(self) -> None:
        self._joints = [0.0] * (2 * JOINT_SLOTS)
        self._gyro: Sequence[float] = (0.0, 0.0, 0.0)
        self._acc: Sequence[float] = (0.0, 0.0, 0.0)
        self._attitude: Sequence[float] = (0.0, 0.0, 0.0, 0.0)
        self._times_ns = [0, 0, 0, 0]  # joint, gyro, accelerometer, attitude
        self._fresh = 0

    def keep(self, samples: Samples) -> None:
        """Keep the newest usable values of the samples of one source."""
        if isinstance(samples, JointSamples):
            for joint, position, torque in zip(
                samples.joint.tolist(),
                samples.position_rad.tolist(),
                samples.torque_nm.tolist(),
                strict=True,
            ):
                if joint < JOINT_SLOTS:
                    self._joints[2 * joint] = position
                    if not math.isnan(torque):
                        self._joints[2 * joint + 1] = torque
                    self._fresh |= 1 << (_FIRST_JOINT + joint)
            self._times_ns[0] = int(samples.t_ns[-1])
        elif isinstance(samples, ImuSamples):
            self._gyro = self._newest(_GYRO, samples.w_NS_S_rad_s, samples.t_gyro_ns, self._gyro)
            self._acc = self._newest(_ACC, samples.f_NS_S_m_s2, samples.t_acc_ns, self._acc)
        elif isinstance(samples, AttitudeSamples):
            self._attitude = self._newest(
                _ATTITUDE, samples.q_NB_xyzw, samples.t_ns, self._attitude
            )

    def _newest(
        self, bit: int, values: FloatArray, t_ns: IntArray, before: Sequence[float]
    ) -> Sequence[float]:
        """Return the newest usable value; without one, the value given as `before`."""
        usable = np.flatnonzero(~np.isnan(values[:, 0]))
        if not usable.size:
            return before
        self._times_ns[1 + bit] = int(t_ns[usable[-1]])
        self._fresh |= 1 << bit
        newest: list[float] = values[usable[-1]].tolist()
        return newest

    def record(self, nis: float) -> bytes:
        """Return the packed record and clear the marks; `nis`: NIS of the newest window."""
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
