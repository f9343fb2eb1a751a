"""Samples of the flight software row by row, and sources that accept plain frames."""

import math
from collections.abc import Sequence
from dataclasses import fields
from types import SimpleNamespace

import numpy as np

from fsw.drivers.sources.joints import JointBusSource
from fsw.drivers.wire import CanFrame, frame_array
from fsw.messages import AttitudeSamples, ImuSamples, JointSamples, Samples

Row = SimpleNamespace


def rows(samples: Samples | None) -> list[Row]:
    """Return samples as rows of plain values; a value that cannot be used is None."""
    if samples is None:
        return []
    names = [field.name for field in fields(samples)]
    columns = [getattr(samples, name).tolist() for name in names]
    assert {len(column) for column in columns} == {len(samples)}
    return [
        Row(**{n: usable(value) for n, value in zip(names, values, strict=True)})
        for values in zip(*columns, strict=True)
    ]


def usable(value: float | int | list[float]) -> float | int | tuple[float, ...] | None:
    """Return a value as it is, a vector as a tuple, and None for what is not a number."""
    if isinstance(value, list):
        return None if math.isnan(value[0]) else tuple(value)
    return None if isinstance(value, float) and math.isnan(value) else value


def plain(samples: Samples | None) -> list[tuple[object, ...]]:
    """Return samples as tuples that can be compared."""
    return [tuple(vars(row).values()) for row in rows(samples)]


class RowSource(JointBusSource):
    """The joints of a bus, fed with plain frames; samples come row by row."""

    def feed(self, frames: Sequence[CanFrame]) -> list[Row]:  # type: ignore[override]
        return rows(super().feed(frame_array(frames)))


def joint_samples(*given: tuple[int, int, int, float, float | None]) -> JointSamples:
    """Return joint samples of rows: validity, receipt [ns], joint, position, torque."""
    t_ns, received_ns, joint, position, torque = zip(*given, strict=True)
    return JointSamples(
        t_ns=np.array(t_ns, np.int64),
        t_receive_ns=np.array(received_ns, np.int64),
        joint=np.array(joint, np.int64),
        position_rad=np.array(position, float),
        torque_nm=np.array([np.nan if tau is None else tau for tau in torque], float),
    )


Vector = tuple[float, float, float]


def imu_samples(*given: tuple[int, int, int, Vector | None, Vector | None]) -> ImuSamples:
    """Return datagrams of rows: times of both clusters and of receipt [ns], rate, force."""
    gyro_ns, acc_ns, received_ns, rates, forces = zip(*given, strict=True)
    none = (np.nan,) * 3
    return ImuSamples(
        t_gyro_ns=np.array(gyro_ns, np.int64),
        t_acc_ns=np.array(acc_ns, np.int64),
        t_receive_ns=np.array(received_ns, np.int64),
        w_NS_S_rad_s=np.array([none if w is None else w for w in rates], float),
        f_NS_S_m_s2=np.array([none if f is None else f for f in forces], float),
    )


def attitude_samples(
    *given: tuple[int, int, tuple[float, float, float, float]],
) -> AttitudeSamples:
    """Return attitudes of rows: validity, receipt [ns], quaternion."""
    t_ns, received_ns, attitudes = zip(*given, strict=True)
    return AttitudeSamples(
        np.array(t_ns, np.int64), np.array(received_ns, np.int64), np.array(attitudes, float)
    )
