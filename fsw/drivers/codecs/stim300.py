"""Safran/Sensonor STIM300 inertial unit, normal-mode datagrams (data sheet TS1524 rev. 31).

Big-endian, without length field or escapes: a frame has a known identifier, the length of this
identifier and a correct CRC-32. After the first datagram only its identifier is searched for (a
unit sends one kind), until 1024 bytes held none.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from fastcrc import crc32
from numpy.typing import NDArray

from fsw.config.constants import STANDARD_GRAVITY_M_S2
from fsw.drivers.codecs.framing import Frame, Framer
from fsw.drivers.codecs.imu_datagram import (
    ImuCodec,
    ImuDatagram,
    ImuRun,
    Vector3,
)
from fsw.drivers.wire import ByteChunk, Reject
from fsw.messages import FloatArray

TICK_S = 1 / 2000  # the counter counts internal samples
COUNTER_MODULUS = 256
GYRO_SCALE_RAD_S = math.radians(2.0**-14)
ACC_SCALE_M_S2 = {
    range_g: STANDARD_GRAVITY_M_S2 * 2.0**-bits
    for range_g, bits in ((5, 20), (10, 19), (30, 18), (80, 16))
}
INCLINATION_SCALE_M_S2 = STANDARD_GRAVITY_M_S2 * 2.0**-22
TEMPERATURE_SCALE_K = 2.0**-8
CR_LF = b"\r\n"
UNLOCK_BYTES = 1024

STATUS_INTEGRITY = 0x80
STATUS_START_UP = 0x40
STATUS_OVERLOAD = 0x10
STATUS_CHANNEL_ERROR = 0x08
STATUS_UNUSABLE = STATUS_INTEGRITY | STATUS_START_UP | STATUS_OVERLOAD | STATUS_CHANNEL_ERROR

DEVICES: Mapping[str, Mapping[str, Any]] = {
    "stim300": {
        "title": "Sensonor STIM300, 10 g",
        "source": "data sheet TS1524 as quoted by navtk::filtering::stim300_model (0.15 "
        "deg/sqrt(h), 0.06 m/s/sqrt(h), bias 4 deg/h and 0.75 mg); delays are an assumption, "
        "measure them",
        "verified": False,
        "rate_hz": 500.0,
        "baud_rate": 921600,
        "gyro_group_delay_s": 2.2e-3,
        "acc_group_delay_s": 6.3e-3,
        "angle_random_walk_rad_sqrt_s": 4.36e-5,
        "velocity_random_walk_m_s_sqrt_s": 1.0e-3,
        "gyro_bias_sigma_rad_s": 2.0e-5,
        "acc_bias_sigma_m_s2": 1.0e-2,
    },
    "stim318": {
        "title": "Sensonor STIM318",
        "source": "data sheet TS1747 from memory (0.15 deg/sqrt(h), 0.015 m/s/sqrt(h)); delays "
        "taken from the STIM300",
        "verified": False,
        "rate_hz": 500.0,
        "baud_rate": 921600,
        "gyro_group_delay_s": 2.2e-3,
        "acc_group_delay_s": 6.3e-3,
        "angle_random_walk_rad_sqrt_s": 4.36e-5,
        "velocity_random_walk_m_s_sqrt_s": 2.5e-4,
        "gyro_bias_sigma_rad_s": 1.5e-5,
        "acc_bias_sigma_m_s2": 1.0e-2,
    },
}
_SETS = ("g", "ga", "gi", "gai")  # clusters: gyro, accelerometer, inclinometer


@dataclass(frozen=True, slots=True)
class Layout:
    """Byte offsets of the fields of one kind of datagram; 0: absent."""

    length: int  # without CR LF
    acc: int
    incl: int
    gyro_temperature: int
    acc_temperature: int
    incl_temperature: int
    extra: int  # PPS or AUX word
    counter: int
    crc: int
    dummies: bytes  # zeros that the CRC covers but the unit does not send


def _layout(clusters: str, temperatures: bool, extra: bool) -> Layout:
    at = {"g": 1}
    position = 11
    for cluster in clusters[1:]:
        at[cluster] = position
        position += 10
    for cluster in clusters if temperatures else "":
        at["t" + cluster] = position
        position += 7
    if extra:
        at["x"] = position
        position += 4
    crc = position + 3
    return Layout(
        length=crc + 4,
        acc=at.get("a", 0),
        incl=at.get("i", 0),
        gyro_temperature=at.get("tg", 0),
        acc_temperature=at.get("ta", 0),
        incl_temperature=at.get("ti", 0),
        extra=at.get("x", 0),
        counter=position,
        crc=crc,
        dummies=bytes(-crc % 4),
    )


def _layouts() -> dict[int, Layout]:
    kinds = [(s, temperatures) for temperatures in (False, True) for s in _SETS]
    plain = (0x90, 0x91, 0x92, 0x93, 0x94, 0xA5, 0xA6, 0xA7)
    pps = tuple(range(0xF0, 0xF8))
    aux = (0x98, 0x99, 0x9A, 0x9B, 0x9C, 0xAD, 0xAE, 0xAF)
    return {
        identifier: _layout(clusters, temperatures, identifiers is not plain)
        for identifiers in (plain, pps, aux)
        for identifier, (clusters, temperatures) in zip(identifiers, kinds, strict=True)
    }


LAYOUTS = _layouts()
_ANY_IDENTIFIER = re.compile(b"[" + re.escape(bytes(LAYOUTS)) + b"]")


@dataclass(frozen=True, slots=True)
class StimDatagram:
    """Every field of a datagram in SI units and sensor axes, usable or not; None: not sent."""

    identifier: int
    gyro_rad_s: Vector3
    gyro_status: int
    acc_m_s2: Vector3 | None
    acc_status: int
    incl_m_s2: Vector3 | None
    incl_status: int
    gyro_temperature_c: Vector3 | None
    acc_temperature_c: Vector3 | None
    incl_temperature_c: Vector3 | None
    temperature_status: tuple[int, int, int]  # gyro, accelerometer, inclinometer
    extra: int | None  # PPS: time since the pulse; AUX: converter reading (raw, signed)
    extra_status: int
    counter: int
    latency_us: int


def check_crc(frame: bytes, layout: Layout) -> bool:
    """Return whether the datagram's CRC-32/MPEG-2, which covers dummy zeros, is correct."""
    crc = layout.crc
    return crc32.mpeg_2(frame[:crc] + layout.dummies) == int.from_bytes(frame[crc : crc + 4], "big")


def decode_datagram(frame: bytes, acc_range_g: int) -> StimDatagram | Reject:
    """Decode every field of one datagram, with or without CR LF at its end."""
    layout = LAYOUTS.get(frame[0]) if frame else None
    if layout is None:
        return Reject.SYNC
    if len(frame) != layout.length and frame[layout.length :] != CR_LF:
        return Reject.LENGTH
    if not check_crc(frame, layout):
        return Reject.CRC
    acc, incl, extra, end = layout.acc, layout.incl, layout.extra, layout.counter
    temperatures = (layout.gyro_temperature, layout.acc_temperature, layout.incl_temperature)
    celsius = [_vector(frame, at, 2, TEMPERATURE_SCALE_K) if at else None for at in temperatures]
    status = [frame[at + 6] if at else 0 for at in temperatures]
    return StimDatagram(
        identifier=frame[0],
        gyro_rad_s=_vector(frame, 1, 3, GYRO_SCALE_RAD_S),
        gyro_status=frame[10],
        acc_m_s2=_vector(frame, acc, 3, ACC_SCALE_M_S2[acc_range_g]) if acc else None,
        acc_status=frame[acc + 9] if acc else 0,
        incl_m_s2=_vector(frame, incl, 3, INCLINATION_SCALE_M_S2) if incl else None,
        incl_status=frame[incl + 9] if incl else 0,
        gyro_temperature_c=celsius[0],
        acc_temperature_c=celsius[1],
        incl_temperature_c=celsius[2],
        temperature_status=(status[0], status[1], status[2]),
        extra=int.from_bytes(frame[extra : extra + 3], "big", signed=True) if extra else None,
        extra_status=frame[extra + 3] if extra else 0,
        counter=frame[end],
        latency_us=frame[end + 1] << 8 | frame[end + 2],
    )


def _vector(frame: bytes, at: int, width: int, scale: float) -> Vector3:
    """Return three big-endian signed integers of `width` bytes, scaled."""
    read = int.from_bytes
    y, z, end = at + width, at + 2 * width, at + 3 * width
    return (
        read(frame[at:y], "big", signed=True) * scale,
        read(frame[y:z], "big", signed=True) * scale,
        read(frame[z:end], "big", signed=True) * scale,
    )


class StimMatcher:
    """Finds datagrams by identifier, length, CRC and, where configured, CR LF."""

    def __init__(self, crlf: bool) -> None:
        self._tail = len(CR_LF) if crlf else 0
        self._locked: bytes | None = None
        self._misses = 0  # bytes searched since the last datagram

    def search(self, data: bytearray, start: int) -> int:
        """Return the place of the next identifier, or the place at which to search again."""
        if self._locked is not None:
            limit = min(len(data), start + UNLOCK_BYTES - self._misses)
            at = data.find(self._locked, start, limit)
            at = limit if at < 0 else at
            self._misses += at - start
            if self._misses >= UNLOCK_BYTES:
                self._locked = None
            return at
        found = _ANY_IDENTIFIER.search(data, start)
        return found.start() if found else len(data)

    def match(self, data: bytearray, start: int) -> int:
        """Return the length of the datagram at `start`; 0 if it is incomplete, -1 if none."""
        layout = LAYOUTS.get(data[start])
        if layout is None:
            return -1
        length = layout.length + self._tail
        if len(data) - start < length:
            return 0
        crc = start + layout.crc
        computed = crc32.mpeg_2(bytes(data[start:crc]) + layout.dummies)
        good = computed == int.from_bytes(data[crc : crc + 4], "big")
        if not good or (self._tail and data[crc + 4 : crc + 6] != CR_LF):
            self._misses += 1
            if self._misses >= UNLOCK_BYTES:
                self._locked = None
            return -1
        self._locked = bytes(data[start : start + 1])
        self._misses = 0
        return length


class Stim300Codec(ImuCodec):
    """Stream codec: `framer` finds datagrams, `decode` turns one into an `ImuDatagram`."""

    title = "Safran/Sensonor STIM300 and STIM318, normal mode"
    devices = DEVICES
    rates_hz = (125.0, 250.0, 500.0, 1000.0, 2000.0)
    max_rate_rad_s = 2**23 * GYRO_SCALE_RAD_S  # a faster rate is sent as just below this
    start_up_bits = STATUS_START_UP
    overload_bits = STATUS_OVERLOAD
    tick_s = TICK_S
    modulus = COUNTER_MODULUS

    def __init__(self, acc_range_g: Literal[5, 10, 30, 80] = 10, crlf: bool = False) -> None:
        self.framer = Framer(StimMatcher(crlf))
        self._tail = len(CR_LF) if crlf else 0
        self.frame_bytes = (
            min(layout.length for layout in LAYOUTS.values() if layout.acc) + self._tail,
            max(layout.length for layout in LAYOUTS.values()) + self._tail,
        )
        self._acc_scale = ACC_SCALE_M_S2[acc_range_g]

    def decode(self, frame: Frame) -> ImuDatagram | Reject:
        """Decode counter, latency, rate and force of a frame that the framer has checked."""
        data = frame.data
        layout = LAYOUTS[data[0]]
        acc, end = layout.acc, layout.counter
        gyro_status = data[10]
        acc_status = data[acc + 9] if acc else 0
        return ImuDatagram(
            data[end],
            (data[end + 1] << 8 | data[end + 2]) * 1e-6,
            None if gyro_status & STATUS_UNUSABLE else _vector(data, 1, 3, GYRO_SCALE_RAD_S),
            _vector(data, acc, 3, self._acc_scale)
            if acc and not acc_status & STATUS_UNUSABLE
            else None,
            gyro_status,
            acc_status,
        )

    def run(self, chunks: Sequence[ByteChunk]) -> ImuRun | None:
        """Decode the leading chunks of intact datagrams of one kind with status 0; else None."""
        count, length = self.framer.peek(chunks)
        layout = LAYOUTS.get(chunks[0].data[0]) if count else None
        if layout is None or not layout.acc or length != layout.length + self._tail:
            return None
        data = b"".join(chunk.data for chunk in chunks[:count])
        rows = np.frombuffer(data, np.uint8).reshape(-1, length)
        good = rows[:, 0] == data[0]
        good &= (rows[:, 10] == 0) & (rows[:, layout.acc + 9] == 0)
        sent = rows[:, layout.crc : layout.crc + 4].copy().view(">u4")[:, 0]
        starts = range(0, len(data), length)
        crcs = [crc32.mpeg_2(data[a : a + layout.crc] + layout.dummies) for a in starts]
        good &= sent == np.array(crcs)
        if self._tail:
            good &= (rows[:, -2] == CR_LF[0]) & (rows[:, -1] == CR_LF[1])
        if np.count_nonzero(good) < len(good):
            ends = np.cumsum([len(chunk.data) // length for chunk in chunks[:count]])
            count = int(np.searchsorted(ends, int(np.argmin(good)), side="right"))
            if not count:
                return None
            rows = rows[: ends[count - 1]]
        end = layout.counter
        return ImuRun(
            chunks=chunks[:count],
            length=length,
            counter=rows[:, end].astype(np.int64),
            latency_s=np.asarray((rows[:, end + 1] * 256.0 + rows[:, end + 2]) * 1e-6, float),
            w_NS_S_rad_s=_vectors(rows[:, 1:10], GYRO_SCALE_RAD_S),
            f_NS_S_m_s2=_vectors(rows[:, layout.acc : layout.acc + 9], self._acc_scale),
        )


def _vectors(data: NDArray[np.uint8], scale: float) -> FloatArray:
    """Return vectors (k, 3) of big-endian signed 24-bit integers (k, 9), scaled."""
    octets = data.reshape(-1, 3, 3).astype(np.int32)
    raw = (octets[..., 0] << 24 | octets[..., 1] << 16 | octets[..., 2] << 8) >> 8
    return np.asarray(raw * scale, float)
