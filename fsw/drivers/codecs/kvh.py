"""KVH 1725, 1750 and 1775 inertial units, format A: 36 bytes, big-endian.

`FE 81 FF 55 | 3 float32 gyros | 3 float32 accelerometers | status | sequence | temperature int16 |
CRC-32/MPEG-2`, the check value over all before it. Status bits 0 to 2 and 4 to 6: gyro and
accelerometer X, Y, Z are valid. Sequence counts messages modulo 128 and is the only time, so that
`rate_hz` must be that of the unit.

No message says whether the unit sends rates or increments, and in which units: this is set on the
unit (`=rotfmt`, `=rotunits`, `=linfmt`, `=linunits`) and declared by the options of the codec.

Source: layout and vectors of github.com/TRECVT/ros_kvh1750 (BSD).
"""

import math
import struct
from collections.abc import Mapping
from typing import Any, Literal

from fastcrc import crc32

from fsw.config.constants import STANDARD_GRAVITY_M_S2
from fsw.drivers.codecs.framing import FixedMatcher, Frame, Framer
from fsw.drivers.codecs.imu_datagram import ImuCodec, ImuDatagram, scaled
from fsw.drivers.wire import Reject

HEADER = b"\xfe\x81\xff\x55"
SEQUENCE_MODULUS = 128
_MESSAGE = struct.Struct(">4s3f3f2BhI")
_CHECKED_BYTES = _MESSAGE.size - 4
_ALL_AXES = 0b111
DEVICES: Mapping[str, Mapping[str, Any]] = {
    "kvh_1750": {
        "title": "KVH 1750",
        "source": "data sheet from memory (0.012 deg/sqrt(h), 0.12 mg/sqrt(Hz), bias 0.1 deg/h "
        "and 1 mg); delays not known, measure them",
        "verified": False,
        "options": {"rotation": "delta", "acceleration": "value"},
        "rate_hz": 500.0,
        "baud_rate": 921600,
        "gyro_group_delay_s": 1.0e-3,
        "acc_group_delay_s": 1.0e-3,
        "angle_random_walk_rad_sqrt_s": 3.5e-6,
        "velocity_random_walk_m_s_sqrt_s": 1.2e-3,
        "gyro_bias_sigma_rad_s": 5.0e-7,
        "acc_bias_sigma_m_s2": 1.0e-2,
    }
}


def _is_intact(frame: bytes) -> bool:
    return crc32.mpeg_2(frame[:-4]) == int.from_bytes(frame[-4:], "big")


class KvhCodec(ImuCodec):
    """Stream codec; `rotation` and `acceleration` say what the unit was set to send."""

    title = "KVH 1725, 1750, 1775, format A"
    devices = DEVICES
    frame_bytes = (_MESSAGE.size, _MESSAGE.size)
    modulus = SEQUENCE_MODULUS

    def __init__(
        self,
        rate_hz: float,
        rotation: Literal["rate", "delta"],
        acceleration: Literal["value", "delta"],
        rotation_unit: Literal["rad", "deg"] = "rad",
        acceleration_unit: Literal["g", "m_s2"] = "g",
    ) -> None:
        self.framer = Framer(FixedMatcher(HEADER, _MESSAGE.size, _is_intact))
        self.tick_s = 1.0 / rate_hz
        self._gyro_interval_s = None if rotation == "delta" else 0.0
        self._acc_interval_s = None if acceleration == "delta" else 0.0
        self._gyro_scale = 1.0 if rotation_unit == "rad" else math.radians(1.0)
        self._acc_scale = STANDARD_GRAVITY_M_S2 if acceleration_unit == "g" else 1.0

    def decode(self, frame: Frame) -> ImuDatagram | Reject:
        """Decode a message that the framer has checked; a cluster needs all its axes."""
        _, *values, status, sequence, _, _ = _MESSAGE.unpack(frame.data)
        gyro_status, acc_status = ~status & _ALL_AXES, ~(status >> 4) & _ALL_AXES
        if sequence >= SEQUENCE_MODULUS:
            return Reject.SEQUENCE
        if not all(map(math.isfinite, values)):
            return Reject.RANGE
        return ImuDatagram(
            sequence,
            0.0,
            None if gyro_status else scaled(values[:3], self._gyro_scale),
            None if acc_status else scaled(values[3:], self._acc_scale),
            gyro_status,
            acc_status,
            self._gyro_interval_s,
            self._acc_interval_s,
        )
