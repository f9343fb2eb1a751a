"""STIM300 normal-mode datagrams, encoded many at a time.

Source: data sheet TS1524 rev. 31 as in the project's ICD. Big-endian throughout. The CRC uses
zlib on bit-reversed bytes (CRC-32/MPEG-2 is zlib's CRC without reflection), so it shares no code
with the flight decoder.
"""

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hil.devices.imu_wire import Batch
from hil.world.sensor_config import ImuSensorConfig

FloatArray = NDArray[np.float64]
ByteArray = NDArray[np.uint8]
G_M_S2 = 9.80665
INTERNAL_RATE_HZ = 2000
RATE_LSB_RAD_S = math.radians(2.0**-14)
ACC_LSB_G = {5: 2.0**-20, 10: 2.0**-19, 30: 2.0**-18, 80: 2.0**-16}
TEMPERATURE_LSB_DEGC = 2.0**-8
STATUS_STARTUP = 0x40
GYRO_DEGC, ACC_DEGC = 25.0, 24.0
_PLAIN = (0x90, 0x91, 0x92, 0x93)
_TEMPERATURE = (0x94, 0xA5, 0xA6, 0xA7)
_PPS = (0xF0, 0xF1, 0xF2, 0xF3, 0xF4, 0xF5, 0xF6, 0xF7)
_AUX = (0x98, 0x99, 0x9A, 0x9B, 0x9C, 0xAD, 0xAE, 0xAF)
_REVERSE = bytes(int(f"{i:08b}"[::-1], 2) for i in range(256))


@dataclass(frozen=True, slots=True)
class Layout:
    """Content of the datagrams of one identifier."""

    acc: bool
    incl: bool
    temperature: bool
    extra: bool  # PPS or AUX word

    @property
    def length(self) -> int:
        """Number of bytes from identifier to CRC."""
        clusters = 1 + self.acc + self.incl
        width = 10 + (7 if self.temperature else 0)
        return 1 + clusters * width + 4 * self.extra + 3 + 4


def layout_of(datagram_id: int) -> Layout:
    """Return the layout of a normal-mode identifier. Raises ValueError for any other."""
    for group, extra in ((_PLAIN + _TEMPERATURE, False), (_PPS, True), (_AUX, True)):
        if datagram_id in group:
            i = group.index(datagram_id)
            return Layout(bool(i & 1), bool(i & 2), bool(i & 4), extra)
    raise ValueError(f"0x{datagram_id:02X} is not a STIM300 normal-mode datagram")


def crc32_mpeg2(data: bytes) -> int:
    """Return CRC-32/MPEG-2: polynomial 0x04C11DB7, seed all ones, unreflected, no final XOR."""
    reflected = zlib.crc32(data.translate(_REVERSE)) ^ 0xFFFFFFFF
    return int.from_bytes(reflected.to_bytes(4, "little").translate(_REVERSE), "big")


def _signed(values: FloatArray, size: int) -> ByteArray:
    """Round (k, c) values to big-endian two's complement of `size` bytes, shape (k, c size)."""
    top = 2 ** (8 * size - 1) - 1
    words = np.clip(np.rint(values), -top - 1, top).astype(">i4")
    octets = words.view(np.uint8).reshape(len(values), -1, 4)[:, :, 4 - size :]
    return octets.reshape(len(values), -1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measurements:
    """k consecutive samples; rates and forces in S axes."""

    w_NS_S_rad_s: FloatArray  # (k, 3)
    f_NS_S_m_s2: FloatArray  # (k, 3)
    inclination_g: FloatArray  # (k, 3)
    gyro_temperature_degc: FloatArray  # (k, 3)
    acc_temperature_degc: FloatArray  # (k, 3)
    incl_temperature_degc: FloatArray  # (k, 3)
    counter: NDArray[np.int64]  # (k,) internal 2 kHz samples
    latency_us: NDArray[np.int64]  # (k,)
    status: NDArray[np.int64]  # (k,) of every cluster


def encode(
    datagram_id: int, samples: Measurements, acc_range_g: int = 10, *, crlf: bool = False
) -> list[bytes]:
    """Return one datagram per sample."""
    layout = layout_of(datagram_id)
    k = len(samples.counter)
    status = samples.status.astype(np.uint8)[:, None]
    acc_scale = G_M_S2 * ACC_LSB_G[acc_range_g]
    columns = [
        np.full((k, 1), datagram_id, np.uint8),
        _signed(samples.w_NS_S_rad_s / RATE_LSB_RAD_S, 3),
        status,
    ]
    if layout.acc:
        columns += [_signed(samples.f_NS_S_m_s2 / acc_scale, 3), status]
    if layout.incl:
        columns += [_signed(samples.inclination_g * 2.0**22, 3), status]
    if layout.temperature:
        columns += [_signed(samples.gyro_temperature_degc / TEMPERATURE_LSB_DEGC, 2), status]
        if layout.acc:
            columns += [_signed(samples.acc_temperature_degc / TEMPERATURE_LSB_DEGC, 2), status]
        if layout.incl:
            columns += [_signed(samples.incl_temperature_degc / TEMPERATURE_LSB_DEGC, 2), status]
    if layout.extra:
        columns.append(np.zeros((k, 4), np.uint8))
    latency = np.minimum(samples.latency_us, 0xFFFF).astype(">u2").view(np.uint8).reshape(k, 2)
    columns += [(samples.counter & 0xFF).astype(np.uint8)[:, None], latency]
    body = np.hstack(columns)
    padding = bytes(-body.shape[1] % 4)
    tail = b"\r\n" if crlf else b""
    rows = (row.tobytes() for row in body)
    return [row + crc32_mpeg2(row + padding).to_bytes(4, "big") + tail for row in rows]


class Wire:
    """Wire format of a STIM300."""

    driver: ClassVar[str] = "stim300"
    has_latency = True
    averages = (False, False)
    options: Mapping[str, Any] = {}

    def __init__(self, config: ImuSensorConfig) -> None:
        if INTERNAL_RATE_HZ % config.rate_hz:
            raise ValueError(f"sensors.imu.rate_hz: must divide 2000 (value: {config.rate_hz})")
        self._config = config
        self.length = layout_of(config.datagram_id).length + 2 * config.crlf

    def encode(self, batch: Batch) -> list[bytes]:
        """Return one datagram for each sample."""
        config, shape = self._config, batch.w_NS_S_rad_s.shape
        samples = Measurements(
            w_NS_S_rad_s=batch.w_NS_S_rad_s,
            f_NS_S_m_s2=batch.f_NS_S_m_s2,
            inclination_g=np.zeros(shape),
            gyro_temperature_degc=np.full(shape, GYRO_DEGC),
            acc_temperature_degc=np.full(shape, ACC_DEGC),
            incl_temperature_degc=np.full(shape, ACC_DEGC),
            counter=batch.counter0 + batch.number * (INTERNAL_RATE_HZ // config.rate_hz),
            latency_us=batch.latency_us,
            status=np.where(batch.starting, STATUS_STARTUP, 0),
        )
        return encode(config.datagram_id, samples, config.acc_range_g, crlf=config.crlf)
