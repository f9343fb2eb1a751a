"""Reaction wheel nodes: TPDO1 and TPDO2, little-endian; other services are as for joint nodes.

Pure functions convert between bytes and values.
"""

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.drivers.codecs.canopen import POSITION_SCALE_RAD, TEMPERATURE_SCALE_K
from fsw.drivers.wire import Reject
from fsw.messages import FloatArray

SPEED_SCALE_RAD_S = POSITION_SCALE_RAD
TORQUE_SCALE_NM = 1e-4
STATUS_OF_SPEED = 0xD8  # speed valid, speed fault, SYNC lost, test data
STATUS_SPEED_VALID = 0x08
TPDO1_BYTES, TPDO2_BYTES = 8, 2
_TPDO1 = np.dtype("<i4, <i2, u1, u1")
_TPDO2 = struct.Struct("<h")


@dataclass(frozen=True, slots=True, eq=False)
class WheelTpdo1:
    """Latched values of wheels; all arrays (k,)."""

    speed_rad_s: FloatArray
    torque_nm: FloatArray
    status: NDArray[np.int64]
    sync_counter: NDArray[np.int64]


def speed_usable(status: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return (k,) whether speeds are valid and no fault or test data is flagged."""
    return np.asarray(status & STATUS_OF_SPEED == STATUS_SPEED_VALID)


def decode_tpdo1(data: NDArray[np.uint8]) -> WheelTpdo1:
    """Decode the data (k, 8) of TPDO1 frames."""
    raw = np.ascontiguousarray(data).view(_TPDO1)[:, 0]
    return WheelTpdo1(
        raw["f0"] * SPEED_SCALE_RAD_S,
        raw["f1"] * TORQUE_SCALE_NM,
        raw["f2"].astype(np.int64),
        raw["f3"].astype(np.int64),
    )


def decode_tpdo2(data: bytes) -> float | Reject:
    """Return the temperature [degC] in a TPDO2."""
    if len(data) != TPDO2_BYTES:
        return Reject.LENGTH
    return float(_TPDO2.unpack(data)[0]) * TEMPERATURE_SCALE_K
