"""MicroStrain 3DM inertial units, MIP protocol: sensor data set 0x80 with a reference time.

`75 65 | descriptor set | payload length | fields | Fletcher-16`, big-endian. A field consists of
its length (which counts the length and descriptor bytes too), its descriptor and its data.
"""

import math
import struct
from collections.abc import Mapping
from typing import Any

from fsw.config.constants import STANDARD_GRAVITY_M_S2
from fsw.drivers.codecs.framing import Frame, Framer, find_sync
from fsw.drivers.codecs.imu_datagram import (
    ImuCodec,
    ImuDatagram,
    Vector3,
)
from fsw.drivers.wire import Reject

SYNC = b"\x75\x65"
SET_SENSOR_DATA = 0x80
FIELD_ACCELERATION = 0x04  # [g], 3 floats
FIELD_RATE = 0x05  # [rad/s], 3 floats
FIELD_REFERENCE_TIME = 0xD5  # u64 [ns]
MAX_PAYLOAD_BYTES = 128  # longer packets are configuration replies, never requested here
_OVERHEAD = 6
DEVICES: Mapping[str, Mapping[str, Any]] = {
    "3dm_gx5": {
        "title": "MicroStrain 3DM-GX5",
        "source": "data sheet from memory (0.005 deg/s/sqrt(Hz), 25 ug/sqrt(Hz)); delays not "
        "known, measure them",
        "verified": False,
        "rate_hz": 500.0,
        "baud_rate": 921600,
        "gyro_group_delay_s": 3.0e-3,
        "acc_group_delay_s": 3.0e-3,
        "angle_random_walk_rad_sqrt_s": 8.73e-5,
        "velocity_random_walk_m_s_sqrt_s": 2.45e-4,
        "gyro_bias_sigma_rad_s": 7.0e-4,
        "acc_bias_sigma_m_s2": 2.0e-2,
    },
    "3dm_cv7": {
        "title": "MicroStrain 3DM-CV7",
        "source": "data sheet from memory (0.0032 deg/s/sqrt(Hz), 25 ug/sqrt(Hz)); delays not "
        "known, measure them",
        "verified": False,
        "rate_hz": 500.0,
        "baud_rate": 921600,
        "gyro_group_delay_s": 3.0e-3,
        "acc_group_delay_s": 3.0e-3,
        "angle_random_walk_rad_sqrt_s": 5.6e-5,
        "velocity_random_walk_m_s_sqrt_s": 2.45e-4,
        "gyro_bias_sigma_rad_s": 7.0e-4,
        "acc_bias_sigma_m_s2": 2.0e-2,
    },
}
_FLOATS = struct.Struct(">3f")
_TIME = struct.Struct(">Q")


def fletcher16(data: bytes) -> bytes:
    """Return MIP's two check bytes: running sums modulo 256."""
    first = second = 0
    for byte in data:
        first += byte
        second += first
    return bytes((first & 0xFF, second & 0xFF))


class MipMatcher:
    """Finds packets by sync bytes, length and checksum."""

    def search(self, data: bytearray, start: int) -> int:
        """Return the place of the next sync bytes."""
        return find_sync(data, SYNC, start)

    def match(self, data: bytearray, start: int) -> int:
        """Return the length of the packet at `start`; 0 if it is incomplete, -1 if none."""
        if len(data) - start < 4:
            return 0
        if data[start + 3] > MAX_PAYLOAD_BYTES:
            return -1
        length = data[start + 3] + _OVERHEAD
        if len(data) - start < length:
            return 0
        end = start + length - 2
        good = fletcher16(bytes(data[start:end])) == data[end : end + 2]
        return length if good else -1


def _listed(descriptors: set[int]) -> str:
    return " ".join(f"0x{descriptor:02x}" for descriptor in sorted(descriptors)) or "nothing"


class MipCodec(ImuCodec):
    """Stream codec: `framer` finds packets, `decode` turns one into an `ImuDatagram`."""

    title = "MicroStrain 3DM units, MIP sensor data"
    devices = DEVICES
    frame_bytes = (44, MAX_PAYLOAD_BYTES + _OVERHEAD)  # only rate, acceleration and time; any
    tick_s = 1e-9
    modulus = 2**64

    def __init__(self) -> None:
        self.framer = Framer(MipMatcher())
        self._sets: set[int] = set()  # descriptor sets of all packets
        self._fields: set[int] = set()  # descriptors of all fields in sensor data

    def lacks(self) -> str:
        """Return in words which fields no packet has had so far; empty: none is missing."""
        if not self._sets:
            return ""
        if SET_SENSOR_DATA not in self._sets:
            return f"no sensor data (set 0x80), found {_listed(self._sets)}"
        if FIELD_REFERENCE_TIME not in self._fields:
            return f"packets have no reference time (field 0xD5), found {_listed(self._fields)}"
        missing = {
            name: field
            for name, field in (("rate", FIELD_RATE), ("acceleration", FIELD_ACCELERATION))
            if field not in self._fields
        }
        if not missing:
            return ""
        fields = ", ".join(f"0x{field:02x}" for field in missing.values())
        others = self._fields - {FIELD_REFERENCE_TIME}
        plural = "s" * (len(missing) > 1)
        return f"no {' and '.join(missing)} (field{plural} {fields}), found {_listed(others)}"

    def decode(self, frame: Frame) -> ImuDatagram | Reject | None:
        """Decode sensor data; reject a packet without reference time.

        Returns None for other packets, such as those of other sets, or of a magnetometer.
        """
        data = frame.data
        self._sets.add(data[2])
        if data[2] != SET_SENSOR_DATA:
            return None
        time_ns: int | None = None
        rate: Vector3 | None = None
        force: Vector3 | None = None
        at, end = 4, len(data) - 2
        while at < end:
            size = data[at]
            if size < 2 or at + size > end:
                return Reject.LENGTH
            descriptor, body = data[at + 1], data[at + 2 : at + size]
            self._fields.add(descriptor)
            if descriptor in (FIELD_ACCELERATION, FIELD_RATE) and len(body) == _FLOATS.size:
                x, y, z = _FLOATS.unpack(body)
                if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
                    return Reject.RANGE
                if descriptor == FIELD_RATE:
                    rate = (x, y, z)
                else:
                    g = STANDARD_GRAVITY_M_S2
                    force = (x * g, y * g, z * g)
            elif descriptor == FIELD_REFERENCE_TIME and len(body) == _TIME.size:
                (time_ns,) = _TIME.unpack(body)
            at += size
        if time_ns is None:
            return Reject.STALE
        if rate is None and force is None:
            return None
        return ImuDatagram(time_ns, 0.0, rate, force)
