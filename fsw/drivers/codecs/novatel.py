"""NovAtel SPAN receivers: raw data of the inertial unit connected to them, little-endian.

Logs RAWIMU (268), RAWIMUS (325), RAWIMUX (1461), RAWIMUSX (1462), after a long header
(`AA 44 12`, its own length) or a short one (`AA 44 13`, 12 bytes), then CRC-32 (reflected
0xEDB88320, start 0, no final exclusive-or) over all before it. The body is `[info U8, type U8]
week, seconds F64, status U32, 3 x I32 of velocity, 3 x I32 of angle`, each in the order Z, -Y, X;
week is U16 in the extended logs and U32 in the others. Values are increments of one sample.

The scale depends on the unit, whose type the extended logs have in `type`; the others need the
option `unit`. `angle_scale_rad` and `velocity_scale_m_s` replace both.

Source: OEM7 manual, log RAWIMUSX; github.com/novatel/novatel_oem7_driver `oem7_imu.cpp` (MIT).
"""

import math
import struct
from typing import NamedTuple
from zlib import crc32

from fsw.drivers.codecs.framing import Frame, Framer, find_sync
from fsw.drivers.codecs.imu_datagram import ImuCodec, ImuDatagram, scaled
from fsw.drivers.wire import Reject

LONG, SHORT = b"\xaa\x44\x12", b"\xaa\x44\x13"
SYNC = LONG[:2]
SHORT_HEADER_BYTES, CHECK_BYTES = 12, 4
MAX_BODY_BYTES = 4096  # of any log on the same port
WEEK_US = 604_800_000_000
INFO_ERROR, INFO_ENCRYPTED = 1, 2
_BODY, _EXTENDED = struct.Struct("<IdI6i"), struct.Struct("<BBHdI6i")
_BODIES = {268: _BODY, 325: _BODY, 1461: _EXTENDED, 1462: _EXTENDED}


class Scale(NamedTuple):
    """Value of one count of a unit: increments of angle and of velocity."""

    angle_rad: float
    velocity_m_s: float


_FOOT_M = 0.3048
_HONEYWELL = Scale(2.0**-33, 2.0**-27 * _FOOT_M)
_LITEF = Scale(1e-9, 2e-8)
SCALES = {  # by type of the unit; those of KVH units are left out: sources differ on their unit
    1: _HONEYWELL,  # HG1700 AG11
    4: Scale(2.0**-33, 2.0**-26 * _FOOT_M),  # HG1700 AG17
    5: _HONEYWELL,  # HG1900 CA29
    8: Scale(2.0**-19, 2.0**-14),  # LN200
    11: _HONEYWELL,  # HG1700 AG58
    12: Scale(2.0**-33, 2.0**-26 * _FOOT_M),  # HG1700 AG62
    13: Scale(math.radians(0.1 / 3600.0) * 2.0**-8, 0.05 * 2.0**-15),  # iMAR FSAS
    20: _HONEYWELL,  # HG1930 AA99
    26: _LITEF,  # ISA-100C
    27: _HONEYWELL,  # HG1900 CA50
    28: _HONEYWELL,  # HG1930 CA50
    31: Scale(math.radians(720.0) * 2.0**-31, 200.0 * 2.0**-31),  # ADIS16488
    32: Scale(math.radians(2.0**-21), 2.0**-22),  # STIM300
    52: _LITEF,  # Litef microIMU
    56: Scale(math.radians(2.0**-21), 2.0**-22),  # STIM300D
    58: Scale(2.0**-33, 2.0**-29),  # HG4930
    68: Scale(2.0**-33, 2.0**-29),
    69: Scale(2.0**-33, 2.0**-29),
}


def check_value(data: bytes) -> bytes:
    """Return the CRC of a log: that of zlib without its start value and its final exclusive-or."""
    return (crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF).to_bytes(4, "little")


def _lengths(data: bytes | bytearray, start: int) -> tuple[int, int] | None:
    """Return the lengths of header and body at `start`; None: not received yet."""
    size = len(data) - start
    if size < 4 or (data[start + 2] == LONG[2] and size < 10):
        return None
    if data[start + 2] == LONG[2]:
        return data[start + 3], data[start + 8] | data[start + 9] << 8
    return SHORT_HEADER_BYTES, data[start + 3]


class NovatelMatcher:
    """Finds logs by sync bytes, lengths in the header, and check value."""

    def search(self, data: bytearray, start: int) -> int:
        """Return the place of the next sync bytes."""
        return find_sync(data, SYNC, start)

    def match(self, data: bytearray, start: int) -> int:
        """Return the length of the log at `start`; 0 if it is incomplete, -1 if none is there."""
        size = len(data) - start
        if size >= 3 and bytes(data[start : start + 3]) not in (LONG, SHORT):
            return -1
        lengths = _lengths(data, start)
        if lengths is None:
            return 0
        if lengths[0] < SHORT_HEADER_BYTES or lengths[1] > MAX_BODY_BYTES:
            return -1
        end = start + sum(lengths)
        if len(data) < end + CHECK_BYTES:
            return 0
        good = check_value(bytes(data[start:end])) == data[end : end + CHECK_BYTES]
        return sum(lengths) + CHECK_BYTES if good else -1


class NovatelCodec(ImuCodec):
    """Stream codec: `framer` finds logs, `decode` turns raw inertial data into increments."""

    title = "NovAtel SPAN, RAWIMU, RAWIMUS, RAWIMUX and RAWIMUSX"
    frame_bytes = (56, 72)  # short and long header
    tick_s = 1e-6
    modulus = 2**63  # GNSS time does not wrap

    def __init__(
        self,
        unit: int | None = None,
        angle_scale_rad: float | None = None,
        velocity_scale_m_s: float | None = None,
    ) -> None:
        scales = (angle_scale_rad, velocity_scale_m_s)
        if scales != (None, None) and not all(scale and 0.0 < scale < 1.0 for scale in scales):
            raise ValueError(
                f"angle_scale_rad, velocity_scale_m_s: {scales}; both must be above 0 and below 1"
            )
        if unit is not None and unit not in SCALES:
            raise ValueError(f"unit: {unit}; must be one of {', '.join(map(str, SCALES))}")
        self.framer = Framer(NovatelMatcher())
        self._unit = unit
        self._fixed: Scale | None = None
        if angle_scale_rad is not None and velocity_scale_m_s is not None:
            self._fixed = Scale(angle_scale_rad, velocity_scale_m_s)
        self._logs: set[int] = set()
        self._unscaled: int | None = None

    def lacks(self) -> str:
        """Return in words which logs or scales are missing; empty: none is missing."""
        if self._logs and not self._logs & _BODIES.keys():
            found = ", ".join(map(str, sorted(self._logs)))
            return f"no raw inertial data (268, 325, 1461, 1462), found logs {found}"
        if self._unscaled is None:
            return ""
        return f"the scale of unit {self._unscaled} is not known; see imu.options"

    def decode(self, frame: Frame) -> ImuDatagram | Reject | None:
        """Decode raw inertial data of a log that the framer has checked."""
        data = frame.data
        log = data[4] | data[5] << 8
        self._logs.add(log)
        layout = _BODIES.get(log)
        if layout is None:
            return None
        header, length = _lengths(data, 0) or (0, 0)
        if length != layout.size:
            return Reject.LENGTH
        *kind, week, seconds, _, vz, vy, vx, az, ay, ax = layout.unpack_from(data, header)
        info, unit = kind or (0, self._unit or 0)
        scale = self._fixed or SCALES.get(unit if self._unit is None else self._unit)
        if scale is None:
            self._unscaled = unit
        if info & (INFO_ERROR | INFO_ENCRYPTED) or scale is None:
            return Reject.STATUS
        if not 0.0 <= seconds <= 1e-6 * WEEK_US:
            return Reject.RANGE
        return ImuDatagram(
            counter=week * WEEK_US + round(seconds * 1e6),
            latency_s=0.0,
            w_NS_S_rad_s=scaled((ax, -ay, az), scale.angle_rad),
            f_NS_S_m_s2=scaled((vx, -vy, vz), scale.velocity_m_s),
            gyro_interval_s=None,
            acc_interval_s=None,
        )
