"""Xsens MTi units: MTData2 with counter, fine sample time and inertial items, big-endian.

Source: MT low-level communication protocol, MTData2.
`device_options`: `items` instant (0x4020, 0x8020) or delta (0x4010, 0x8030).
"""

import struct
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from hil.devices.imu_wire import Batch, FloatArray
from hil.world.sensor_config import ImuSensorConfig

PREAMBLE = b"\xfa\xff\x36"
TICKS_HZ = 10_000
LONGEST = 519
# layout of the items, and identifier and length of the last two: forces, rates or increments
_INSTANT = (struct.Struct(">3xB HBH HBI HB3f HB3f"), (0x4020, 12), (0x8020, 12))
_INCREMENTS = (struct.Struct(">3xB HBH HBI HB3f HB4f"), (0x4010, 12), (0x8030, 16))
VECTOR = bytes.fromhex(  # of a MTi-630: orientation, time, status, counter
    "FAFF36262010103EFC23423F00E028BF018FA73EFEEEB1106004000AF84CE02004000000021020021BC5D4"
)


def seal(payload: bytes) -> bytes:
    """Return the message of a payload: length in its fourth byte, then items of that length."""
    length = min(254, payload[3]) if len(payload) > 3 else 0
    body = PREAMBLE + bytes((length,)) + payload[4 : 4 + length].ljust(length, b"\0")
    return body + bytes((-sum(body[1:]) & 0xFF,))


def quaternions(turns_rad: FloatArray) -> FloatArray:
    """Return the quaternions w x y z (k, 4) of rotation vectors (k, 3)."""
    angle = np.linalg.norm(turns_rad, axis=1, keepdims=True)
    vector = 0.5 * np.sinc(0.5 * angle / np.pi) * turns_rad
    return np.hstack([np.cos(0.5 * angle), vector])


class Wire:
    """Wire format of an MTi."""

    driver: ClassVar[str] = "xsens"
    has_latency = False
    options: Mapping[str, Any] = {}

    def __init__(self, config: ImuSensorConfig) -> None:
        is_delta = config.device_options.get("items", "instant") == "delta"
        self.averages = (is_delta, is_delta)
        self.length = 5 + 5 + 7 + 15 + (19 if is_delta else 15)

    def encode(self, batch: Batch) -> list[bytes]:
        """Return one message for each sample."""
        number = batch.number + batch.counter0
        ticks = np.rint(number * batch.period_s * TICKS_HZ).astype(np.int64)
        rate, force = batch.w_NS_S_rad_s, batch.f_NS_S_m_s2
        items, values = _INSTANT, (force, rate)
        if self.averages[0]:
            items = _INCREMENTS
            values = (force * batch.period_s, quaternions(rate * batch.period_s))
        columns = (number % 2**16, ticks % 2**32, *values)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        layout, first, second = items
        size = layout.size - 4
        return [
            seal(layout.pack(size, 0x1020, 2, count, 0x1060, 4, tick, *first, *f, *second, *w))
            for count, tick, f, w in rows
        ]
