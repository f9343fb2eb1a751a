"""NovAtel SPAN: log RAWIMUSX (1462) with a STIM300 (type 32), little-endian.

Source: OEM7 manual, RAWIMUSX and the 32-bit CRC, computed as printed there.
"""

import struct
from collections.abc import Mapping
from functools import cache
from typing import Any, ClassVar

import numpy as np

from hil.devices.imu_wire import Batch
from hil.world.sensor_config import ImuSensorConfig

SYNC, MESSAGE, UNIT = b"\xaa\x44\x13", 1462, 32
BODY_BYTES = 40
WEEK, SECONDS = 2200, 345_600.0  # of GNSS time at power-on
STATUS = 0
_LOG = struct.Struct("<3xB HHI BBHdI6i")
ANGLE_RAD, VELOCITY_M_S = np.radians(2.0**-21), 2.0**-22
LONGEST = 28 + 4096 + 4
VECTOR = bytes.fromhex(  # tests of NovAtel's EDIE, which print the same log as text
    "AA441328B6059C0678B9E21C000B9C060B9755A832941D4103158000EBD09102A687F3FF38EAFCFF66B7FCFF"
    "1C5FFFFF59D9FFFF475FAFBA"
)


@cache
def crc_of_byte(value: int) -> int:
    """Return the CRC of one byte, as the manual's CRC32Value."""
    for _ in range(8):
        value = value >> 1 ^ (0xEDB88320 if value & 1 else 0)
    return value


def crc(data: bytes) -> int:
    """Return the CRC of a log, as the manual's CalculateBlockCRC32."""
    value = 0
    for byte in data:
        value = value >> 8 ^ crc_of_byte((value ^ byte) & 0xFF)
    return value


def seal(payload: bytes) -> bytes:
    """Return the short log with the length in the fourth byte of a payload, and its CRC."""
    end = 12 + (payload[3] if len(payload) > 3 else 0)
    log = SYNC + payload[3:end].ljust(end - 3, b"\0")
    return log + crc(log).to_bytes(4, "little")


class Wire:
    """Wire format of RAWIMUSX."""

    driver: ClassVar[str] = "novatel"
    has_latency = False
    averages = (True, True)
    length = 12 + BODY_BYTES + 4
    options: Mapping[str, Any] = {}

    def __init__(self, config: ImuSensorConfig) -> None:
        """Create the format; it has no settings."""

    def encode(self, batch: Batch) -> list[bytes]:
        """Return one log for each sample."""
        seconds = SECONDS + (batch.number + batch.counter0) * batch.period_s
        angle = np.rint(batch.w_NS_S_rad_s * batch.period_s / ANGLE_RAD)
        velocity = np.rint(batch.f_NS_S_m_s2 * batch.period_s / VELOCITY_M_S)
        order, signs = [2, 1, 0], np.array([1.0, -1.0, 1.0])  # Z, -Y, X
        milliseconds = np.rint(1e3 * seconds).astype(np.int64)
        counts = np.hstack([velocity[:, order] * signs, angle[:, order] * signs]).astype(np.int64)
        return [
            seal(
                _LOG.pack(
                    BODY_BYTES, MESSAGE, WEEK, round(1e3 * now), 0, UNIT, WEEK, now, STATUS, *row
                )
            )
            for now, ms, row in zip(
                seconds.tolist(), milliseconds.tolist(), counts.tolist(), strict=True
            )
        ]
