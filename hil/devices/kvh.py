"""KVH 1725, 1750, 1775 inertial units, format A, 36 bytes, big-endian.

Source: layout in github.com/TRECVT/ros_kvh1750 (types.h). The CRC is zlib's on bit-reversed bytes.
`device_options`: `rotation` rate or delta, `acceleration` value or delta, as the unit was set.
"""

import struct
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from hil.devices.imu_wire import Batch
from hil.devices.stim300 import crc32_mpeg2
from hil.world.sensor_config import ImuSensorConfig

START = 0xFE81FF55
G_M_S2 = 9.80665
ALL_VALID, GYROS_INVALID = 0x77, 0x70
DEGC = 29
LONGEST = 36
_BODY = struct.Struct(">I6f2Bh")
VECTOR = bytes.fromhex(  # test/utest.cpp of the source, "basic"
    "FE81FF55B3D0BBE732193EF430AC19A5BA8F78D63A2905943F7ECBD47768001DADC5F651"
)


def seal(payload: bytes) -> bytes:
    """Return a message of a payload: header in front, 28 bytes, CRC."""
    body = START.to_bytes(4, "big") + payload[4:32].ljust(28, b"\0")
    return body + crc32_mpeg2(body).to_bytes(4, "big")


class Wire:
    """Wire format of a KVH unit."""

    driver: ClassVar[str] = "kvh"
    has_latency = False
    length = LONGEST

    def __init__(self, config: ImuSensorConfig) -> None:
        set_to = {"rotation": "delta", "acceleration": "value"} | dict(config.device_options)
        self.options: Mapping[str, Any] = set_to
        self.averages = (set_to["rotation"] == "delta", set_to["acceleration"] == "delta")

    def encode(self, batch: Batch) -> list[bytes]:
        """Return one message for each sample."""
        gyro_s, acc_s = (batch.period_s if averages else 1.0 for averages in self.averages)
        status = np.where(batch.starting, GYROS_INVALID, ALL_VALID)
        values = np.hstack([batch.w_NS_S_rad_s * gyro_s, batch.f_NS_S_m_s2 / G_M_S2 * acc_s])
        counters = (batch.counter0 + batch.number) % 128
        return [
            seal(_BODY.pack(START, *row, valid, counter, DEGC))
            for row, valid, counter in zip(
                values.tolist(), status.tolist(), counters.tolist(), strict=True
            )
        ]
