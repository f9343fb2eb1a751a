"""VectorNav binary output, little-endian.

`FA | groups | U16 field mask of each group | fields of each group | CRC-16`, the check value
(polynomial 0x1021, start 0) big-endian, over all after FA; computed over itself too, it is 0. The
masks fix the length. The codec reads time since start-up, rate and acceleration. It prefers
uncompensated values, because the unit's own filter changes the others; increments with their own
interval replace missing ones.

Source: VN-100 manual UM001 section 4.3 and vnproglib 1.1.5 (`Packet::BinaryGroupLengths`).
"""

import math
import struct
from collections.abc import Mapping
from typing import Any

from fastcrc import crc16

from fsw.drivers.codecs.framing import Frame, Framer, find_sync
from fsw.drivers.codecs.imu_datagram import ImuCodec, ImuDatagram, Vector3, scaled
from fsw.drivers.wire import Reject

SYNC = b"\xfa"
LENGTHS = (  # bytes of the fields of each group, by bit of its mask; 0: unknown or variable
    (8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8),
    (8, 8, 8, 2, 8, 8, 8, 4, 4, 1),
    (2, 12, 12, 12, 4, 4, 16, 12, 12, 12, 12, 2, 40),
    (8, 8, 2, 1, 1, 24, 24, 12, 12, 12, 4, 4, 2, 28),
    (2, 12, 16, 36, 12, 12, 12, 12, 12, 12, 28, 24),
    (2, 24, 24, 12, 12, 12, 12, 12, 12, 4, 4, 68, 64),
)
COMMON, TIME, INERTIAL = 0, 1, 2  # groups
MAX_FRAME_BYTES = 512
# groups and bits of fields, the preferred one first
_TIMES = ((COMMON, 0), (TIME, 0))
_RATES = ((COMMON, 9), (INERTIAL, 3), (COMMON, 5), (INERTIAL, 10))
_FORCES = ((COMMON, 9), (INERTIAL, 2), (COMMON, 8), (INERTIAL, 9))
_ANGLES = ((COMMON, 11), (INERTIAL, 6))  # interval [s] and increment of the angle [deg]
_VECTOR, _TIMED, _TIME = struct.Struct("<3f"), struct.Struct("<f3f"), struct.Struct("<Q")
Place = tuple[int, int]
Fields = dict[Place, bytes]
DEVICES: Mapping[str, Mapping[str, Any]] = {
    "vn_100": {
        "title": "VectorNav VN-100",
        "source": "data sheet from memory (0.0035 deg/s/sqrt(Hz), 0.14 mg/sqrt(Hz)); delays "
        "not known, measure them",
        "verified": False,
        "rate_hz": 200.0,
        "baud_rate": 921600,
        "gyro_group_delay_s": 3.0e-3,
        "acc_group_delay_s": 3.0e-3,
        "angle_random_walk_rad_sqrt_s": 6.1e-5,
        "velocity_random_walk_m_s_sqrt_s": 1.4e-3,
        "gyro_bias_sigma_rad_s": 1.0e-3,
        "acc_bias_sigma_m_s2": 5.0e-2,
    }
}


def _places(data: bytes | bytearray, start: int) -> tuple[dict[Place, tuple[int, int]], int] | None:
    """Return begin and end of each field of a packet, and its length; None if masks are unknown."""
    groups = data[start + 1]
    chosen = [group for group in range(8) if groups >> group & 1]
    if not chosen or chosen[-1] >= len(LENGTHS):
        return None
    at = 2 + 2 * len(chosen)
    places: dict[Place, tuple[int, int]] = {}
    for k, group in enumerate(chosen):
        mask = int.from_bytes(data[start + 2 + 2 * k : start + 4 + 2 * k], "little")
        if mask >> len(LENGTHS[group]):
            return None
        for bit, length in enumerate(LENGTHS[group]):
            if mask >> bit & 1:
                places[group, bit] = (at, at + length)
                at += length
    return (places, at + 2) if places and at + 2 <= MAX_FRAME_BYTES else None


class VectorNavMatcher:
    """Finds packets by sync byte, masks that give the length, and check value."""

    def search(self, data: bytearray, start: int) -> int:
        """Return the place of the next sync byte."""
        return find_sync(data, SYNC, start)

    def match(self, data: bytearray, start: int) -> int:
        """Return the length of the packet at `start`; 0 if it is incomplete, -1 if none."""
        size = len(data) - start
        if size < 2 or size < 2 + 2 * data[start + 1].bit_count():
            return 0
        found = _places(data, start)
        if found is None:
            return -1
        length = found[1]
        if size < length:
            return 0
        return length if crc16.xmodem(bytes(data[start + 1 : start + length])) == 0 else -1


class VectorNavCodec(ImuCodec):
    """Stream codec: `framer` finds packets, `decode` turns one into an `ImuDatagram`."""

    title = "VectorNav units, binary output"
    devices = DEVICES
    frame_bytes = (38, 90)  # time, rate and acceleration; every field that is read
    tick_s = 1e-9
    modulus = 2**64

    def __init__(self) -> None:
        self.framer = Framer(VectorNavMatcher())
        self._seen: set[Place] = set()

    def lacks(self) -> str:
        """Return in words which fields no packet has had so far; empty: none is missing."""
        wanted = {
            "time since start-up (group 1 bit 0)": _TIMES,
            "rate (group 1 bit 5)": (*_RATES, *_ANGLES),
            "acceleration (group 1 bit 8)": (*_FORCES, (COMMON, 11), (INERTIAL, 7)),
        }
        missing = [words for words, places in wanted.items() if not self._seen & {*places}]
        return "no " + " and no ".join(missing) if missing and self._seen else ""

    def decode(self, frame: Frame) -> ImuDatagram | Reject | None:
        """Decode a packet that the framer has checked; reject one without a time."""
        found = _places(frame.data, 0)
        if found is None:
            return Reject.LENGTH
        fields = {place: frame.data[begin:end] for place, (begin, end) in found[0].items()}
        self._seen |= fields.keys()
        rate, gyro_s = _rate(fields)
        force, acc_s = _force(fields)
        if rate is None and force is None:
            return None
        time = _first(fields, _TIMES)
        if time is None:
            return Reject.STALE
        if not all(map(math.isfinite, (*(rate or ()), *(force or ()), gyro_s, acc_s))):
            return Reject.RANGE
        (time_ns,) = _TIME.unpack(time)
        return ImuDatagram(time_ns, 0.0, rate, force, 0, 0, gyro_s, acc_s)


def _first(fields: Fields, places: tuple[Place, ...]) -> bytes | None:
    return next((fields[place] for place in places if place in fields), None)


def _rate(fields: Fields) -> tuple[Vector3 | None, float]:
    """Return the rate [rad/s] and the interval over which it is a mean [s]."""
    if (body := _first(fields, _RATES)) is not None:
        return scaled(_VECTOR.unpack(body[-12:]), 1.0), 0.0  # the rate is last in the field Imu
    if (body := _first(fields, _ANGLES)) is not None:
        interval_s, *angle_deg = _TIMED.unpack_from(body)
        if interval_s > 0.0:
            return scaled(angle_deg, math.radians(1.0) / interval_s), interval_s
    return None, 0.0


def _force(fields: Fields) -> tuple[Vector3 | None, float]:
    """Return the specific force [m/s^2] and the interval over which it is a mean [s]."""
    if (body := _first(fields, _FORCES)) is not None:
        return scaled(_VECTOR.unpack(body[:12]), 1.0), 0.0
    timed, body = _first(fields, _ANGLES), fields.get((INERTIAL, 7))
    if timed is None or (body is None and (COMMON, 11) not in fields):
        return None, 0.0
    interval_s = _TIMED.unpack_from(timed)[0]
    if not interval_s > 0.0:
        return None, 0.0
    velocity = _VECTOR.unpack(timed[16:] if body is None else body)
    return scaled(velocity, 1.0 / interval_s), interval_s
