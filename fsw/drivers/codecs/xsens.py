"""Xsens MTi units, Xbus message MTData2, big-endian.

`FA FF 36 | length | items | check byte`; a length of FF is followed by the length as U16, and the
sum of all bytes after FA is 0 modulo 256. An item is its identifier (U16; the lowest two bits are
the number format), its length (U8) and its data. The codec reads the fine sample time (0x1060),
rate of turn (0x8020) and acceleration (0x4020), or instead of these two the increments of rotation
(0x8030) and velocity (0x4010).

Source: Xsens MT low-level communication protocol, as in github.com/ethz-asl/ethzasl_xsens_driver.
"""

import math
import struct
from collections.abc import Iterator, Mapping
from typing import Any

from fsw.drivers.codecs.framing import Frame, Framer, find_sync
from fsw.drivers.codecs.imu_datagram import ImuCodec, ImuDatagram, Vector3
from fsw.drivers.wire import Reject

SYNC = b"\xfa\xff"
MT_DATA_2 = 0x36
LONG = 0xFF  # in place of a length: a U16 follows
MAX_PAYLOAD_BYTES = 512
SAMPLE_TIME_FINE, DELTA_V, ACCELERATION, RATE, DELTA_Q = 0x1060, 0x4010, 0x4020, 0x8020, 0x8030
ITEM = 0xFFF0  # of an identifier: without coordinate system and number format
_SIZES = (4, 4, 6, 8)  # bytes of a number: float32, 12.20, 16.32, float64
DEVICES: Mapping[str, Mapping[str, Any]] = {
    "mti_300": {
        "title": "Xsens MTi-300",
        "source": "data sheet from memory (0.01 deg/s/sqrt(Hz), 60 ug/sqrt(Hz)); delays not "
        "known, measure them",
        "verified": False,
        "rate_hz": 400.0,
        "baud_rate": 921600,
        "gyro_group_delay_s": 2.0e-3,
        "acc_group_delay_s": 2.0e-3,
        "angle_random_walk_rad_sqrt_s": 1.75e-4,
        "velocity_random_walk_m_s_sqrt_s": 5.9e-4,
        "gyro_bias_sigma_rad_s": 3.5e-3,
        "acc_bias_sigma_m_s2": 5.0e-2,
    }
}


def _payload(data: bytes | bytearray, start: int) -> tuple[int, int] | None:
    """Return where the payload begins and its length; None: not received yet."""
    size = len(data) - start
    if size < 4 or (data[start + 3] == LONG and size < 6):
        return None
    if data[start + 3] != LONG:
        return start + 4, data[start + 3]
    return start + 6, data[start + 4] << 8 | data[start + 5]


def _items(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield identifier and data of each item; stop at one that is not complete."""
    at = 0
    while at + 3 <= len(data) and at + 3 + data[at + 2] <= len(data):
        yield data[at] << 8 | data[at + 1], data[at + 3 : at + 3 + data[at + 2]]
        at += 3 + data[at + 2]


class XbusMatcher:
    """Finds messages by sync bytes, length, check byte, and items that fill the payload."""

    def search(self, data: bytearray, start: int) -> int:
        """Return the place of the next sync bytes."""
        return find_sync(data, SYNC, start)

    def match(self, data: bytearray, start: int) -> int:
        """Return the length of the message at `start`; 0 if it is incomplete, -1 if none."""
        found = _payload(data, start)
        if found is None:
            return 0
        begin, size = found
        if size > MAX_PAYLOAD_BYTES:
            return -1
        end = begin + size + 1
        if len(data) < end:
            return 0
        if sum(data[start + 1 : end]) & 0xFF:
            return -1
        items = _items(bytes(data[begin : end - 1]))
        whole = data[start + 2] != MT_DATA_2 or sum(3 + len(item) for _, item in items) == size
        return end - start if whole else -1


def _numbers(identifier: int, data: bytes) -> list[float]:
    """Return the numbers of an item in the format that its identifier says."""
    kind = identifier & 3
    size = _SIZES[kind]
    parts = [data[at : at + size] for at in range(0, len(data) - size + 1, size)]
    if kind == 0:
        return [struct.unpack(">f", part)[0] for part in parts]
    if kind == 1:
        return [int.from_bytes(part, "big", signed=True) * 2.0**-20 for part in parts]
    if kind == 2:  # the fraction is sent before the whole
        whole = [part[4:] + part[:4] for part in parts]
        return [int.from_bytes(part, "big", signed=True) * 2.0**-32 for part in whole]
    return [struct.unpack(">d", part)[0] for part in parts]


def _rotation_vector(w: float, x: float, y: float, z: float) -> Vector3:
    """Return the rotation vector [rad] of a quaternion that is nearly one."""
    sine = math.sqrt(x * x + y * y + z * z)
    angle = 2.0 * math.atan2(sine, abs(w)) * math.copysign(1.0, w)
    ratio = angle / sine if sine > 0.0 else 2.0
    return (ratio * x, ratio * y, ratio * z)


class XsensCodec(ImuCodec):
    """Stream codec: `framer` finds messages, `decode` turns one into an `ImuDatagram`."""

    title = "Xsens MTi units, MTData2"
    devices = DEVICES
    frame_bytes = (42, 88)  # time, rate and acceleration; with increments, counter and status
    tick_s = 1e-4
    modulus = 2**32

    def __init__(self) -> None:
        self.framer = Framer(XbusMatcher())
        self._seen: set[int] = set()

    def lacks(self) -> str:
        """Return in words which items no message has had so far; empty: none is missing."""
        wanted = {
            "fine sample time (0x1060)": {SAMPLE_TIME_FINE},
            "rate of turn (0x8020) or its increment (0x8030)": {RATE, DELTA_Q},
            "acceleration (0x4020) or its increment (0x4010)": {ACCELERATION, DELTA_V},
        }
        missing = [words for words, items in wanted.items() if not self._seen & items]
        return "no " + " and no ".join(missing) if missing and self._seen else ""

    def decode(self, frame: Frame) -> ImuDatagram | Reject | None:
        """Decode measurements; reject those without the fine sample time."""
        found = _payload(frame.data, 0)
        if frame.data[2] != MT_DATA_2 or found is None:
            return None
        items = {i & ITEM: (i, data) for i, data in _items(frame.data[found[0] : -1])}
        self._seen |= items.keys()
        values = {item: _numbers(*items[item]) for item in items if item in _COUNTS}
        if not values:
            return None
        if any(len(numbers) != _COUNTS[item] for item, numbers in values.items()):
            return Reject.LENGTH
        if not all(math.isfinite(number) for numbers in values.values() for number in numbers):
            return Reject.RANGE
        time = items.get(SAMPLE_TIME_FINE, (0, b""))[1]
        if len(time) != 4:
            return Reject.STALE
        rate, force = _vector(values.get(RATE)), _vector(values.get(ACCELERATION))
        turn, velocity = values.get(DELTA_Q), _vector(values.get(DELTA_V))
        return ImuDatagram(
            counter=int.from_bytes(time, "big"),
            latency_s=0.0,
            w_NS_S_rad_s=_rotation_vector(*turn) if turn and rate is None else rate,
            f_NS_S_m_s2=velocity if force is None else force,
            gyro_interval_s=None if rate is None else 0.0,
            acc_interval_s=None if force is None else 0.0,
        )


_COUNTS = {RATE: 3, DELTA_Q: 4, ACCELERATION: 3, DELTA_V: 3}  # numbers in an item


def _vector(numbers: list[float] | None) -> Vector3 | None:
    return None if numbers is None else (numbers[0], numbers[1], numbers[2])
