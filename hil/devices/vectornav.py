"""VectorNav binary output: common group with time since start-up, rate and acceleration.

Source: VN-100 manual UM001, section 4.3. Little-endian; the CRC-16 is sent big-endian.
`device_options`: `fields` instant (bits 0, 5, 8) or delta (bits 0, 11).
"""

import struct
from binascii import crc_hqx  # polynomial 0x1021
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from hil.devices.imu_wire import Batch
from hil.world.sensor_config import ImuSensorConfig

SYNC, COMMON = 0xFA, 0x01
TIME, RATE, ACCELERATION, INCREMENTS = 1 << 0, 1 << 5, 1 << 8, 1 << 11
SIZES = (8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8)  # of the fields, by bit
LONGEST = 512
VECTOR = bytes.fromhex("FA01080093502E42833EF13F48B504BB9288")  # UM001, yaw, pitch, roll


def seal(payload: bytes) -> bytes:
    """Return the packet of the common group with the mask and the fields of a payload."""
    mask = int.from_bytes(payload[2:4].ljust(2, b"\0"), "little") % 2 ** len(SIZES) or TIME
    end = 4 + sum(size for bit, size in enumerate(SIZES) if mask >> bit & 1)
    body = bytes((COMMON,)) + mask.to_bytes(2, "little") + payload[4:end].ljust(end - 4, b"\0")
    return bytes((SYNC,)) + body + crc_hqx(body, 0).to_bytes(2, "big")


class Wire:
    """Wire format of a VectorNav unit."""

    driver: ClassVar[str] = "vectornav"
    has_latency = False
    options: Mapping[str, Any] = {}

    def __init__(self, config: ImuSensorConfig) -> None:
        is_delta = config.device_options.get("fields", "instant") == "delta"
        self.averages = (is_delta, is_delta)
        self.length = 4 + 8 + (28 if is_delta else 24) + 2

    def encode(self, batch: Batch) -> list[bytes]:
        """Return one packet for each sample."""
        period_s = batch.period_s
        time_ns = np.rint((batch.number + batch.counter0) * (1e9 * period_s)).astype(np.int64)
        rate, force = batch.w_NS_S_rad_s, batch.f_NS_S_m_s2
        mask, values = TIME | RATE | ACCELERATION, np.hstack([rate, force])
        if self.averages[0]:
            steps = np.full((len(rate), 1), period_s)
            mask = TIME | INCREMENTS
            values = np.hstack([steps, np.degrees(rate) * period_s, force * period_s])
        layout = struct.Struct(f"<xxHQ{values.shape[1]}f")
        rows = zip(time_ns.tolist(), values.tolist(), strict=True)
        return [seal(layout.pack(mask, now_ns, *row)) for now_ns, row in rows]
