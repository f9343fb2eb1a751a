"""CANopen joint nodes: CiA 301/402 objects over ECSS-E-ST-50-15C services, little-endian.

Pure functions convert between bytes and values, for TPDO1 of many frames at once. Identifiers are
bare 11-bit COB-IDs.
"""

import math
import struct
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from fsw.drivers.wire import Reject
from fsw.messages import FloatArray

COB_NMT = 0x000
COB_SYNC = 0x080
COB_EMCY = 0x080  # + node
COB_TPDO1 = 0x180  # + node
COB_TPDO2 = 0x280  # + node
COB_HEARTBEAT = 0x700  # + node
MASTER_NODE = 0x01
FUNCTION_MASK = 0x780
NODE_MASK = 0x07F

POSITION_SCALE_RAD = math.tau * 2.0**-24
TORQUE_SCALE_NM = 0.01
FD_TORQUE_SCALE_NM = 1e-4
TEMPERATURE_SCALE_K = 0.1
RATED_TORQUE_SCALE = 1e-3

STATUS_TORQUE_VALID = 0x01
STATUS_TORQUE_OVERLOAD = 0x02
STATUS_TORQUE_FAULT = 0x04
STATUS_ENCODER_VALID = 0x08
STATUS_ENCODER_FAULT = 0x10
STATUS_BRAKE_ENGAGED = 0x20
STATUS_SYNC_LOST = 0x40
STATUS_TEST_DATA = 0x80
STATUS_OF_TORQUE = STATUS_TORQUE_VALID | STATUS_TORQUE_OVERLOAD | STATUS_TORQUE_FAULT
# without the brake bit: the readings of a braked joint are valid
STATUS_OF_POSITION = 0xFF & ~STATUS_OF_TORQUE & ~STATUS_BRAKE_ENGAGED

TPDO1_BYTES, FD_TPDO1_BYTES, TPDO2_BYTES = 8, 20, 8
_TPDO1 = np.dtype("<i4, <i2, u1, u1")
_FD = np.dtype("<i4, <i4, <i4, <u2, u1, i1, <u4")
_TPDO2 = struct.Struct("<ihh")


class NmtCommand(IntEnum):
    """Commands of the NMT master."""

    START = 0x01
    STOP = 0x02
    PRE_OPERATIONAL = 0x80


class NmtState(IntEnum):
    """States a heartbeat reports."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


@dataclass(frozen=True, slots=True, eq=False)
class Tpdo1:
    """Latched link-side values of joints, uncalibrated; all arrays (k,).

    A node without an angle sends its velocity [rad/s] in place of the position.
    """

    position_rad: FloatArray
    torque_nm: FloatArray
    status: NDArray[np.int64]
    sync_counter: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class FdTpdo1(Tpdo1):
    """TPDO1 in its CAN FD tailoring, with three more values."""

    velocity_rad_s: FloatArray
    temperature_c: FloatArray
    device_time_us: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Tpdo2:
    """Slow values of one joint (TPDO2); the motor torque is a ratio of the rated torque."""

    velocity_rad_s: float
    motor_torque_ratio: float
    temperature_c: float


@dataclass(frozen=True, slots=True)
class Emergency:
    """EMCY object: error code, error register, manufacturer's bytes."""

    code: int
    register: int
    detail: bytes


def position_usable(status: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return (k,) whether positions are valid and no test data; the brake bit is ignored."""
    return np.asarray(status & STATUS_OF_POSITION == STATUS_ENCODER_VALID)


def torque_usable(status: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return (k,) whether torques are valid and their sensors flag no fault or overload."""
    return np.asarray(status & STATUS_OF_TORQUE == STATUS_TORQUE_VALID)


def decode_tpdo1(data: NDArray[np.uint8]) -> Tpdo1:
    """Decode the data (k, 8) of classic TPDO1 frames."""
    raw = np.ascontiguousarray(data).view(_TPDO1)[:, 0]
    return Tpdo1(
        raw["f0"] * POSITION_SCALE_RAD,
        raw["f1"] * TORQUE_SCALE_NM,
        raw["f2"].astype(np.int64),
        raw["f3"].astype(np.int64),
    )


def decode_fd(data: NDArray[np.uint8]) -> FdTpdo1:
    """Decode the data (k, 20) of frames of the CAN FD tailoring of TPDO1."""
    raw = np.ascontiguousarray(data).view(_FD)[:, 0]
    return FdTpdo1(
        position_rad=raw["f0"] * POSITION_SCALE_RAD,
        velocity_rad_s=raw["f1"] * POSITION_SCALE_RAD,
        torque_nm=raw["f2"] * FD_TORQUE_SCALE_NM,
        status=raw["f3"].astype(np.int64),
        sync_counter=raw["f4"].astype(np.int64),
        temperature_c=raw["f5"].astype(np.float64),
        device_time_us=raw["f6"].astype(np.int64),
    )


def decode_tpdo2(data: bytes) -> Tpdo2 | Reject:
    """Decode the slow TPDO2."""
    if len(data) != _TPDO2.size:
        return Reject.LENGTH
    velocity, torque, temperature = _TPDO2.unpack(data)
    return Tpdo2(
        velocity * POSITION_SCALE_RAD,
        torque * RATED_TORQUE_SCALE,
        temperature * TEMPERATURE_SCALE_K,
    )


def decode_heartbeat(data: bytes) -> int | Reject:
    """Return the node's state (an `NmtState` if it is a known one); 0 is the boot-up message."""
    if len(data) != 1:
        return Reject.LENGTH
    return data[0] & 0x7F


def decode_emcy(data: bytes) -> Emergency | Reject:
    """Decode an emergency object; code 0 means the error is reset."""
    if len(data) != 8:
        return Reject.LENGTH
    return Emergency(int.from_bytes(data[:2], "little"), data[2], data[3:])


def decode_sync(data: bytes, counter_max: int) -> int | Reject:
    """Return the counter of a SYNC, 1 to `counter_max`, or the reason for its rejection."""
    if len(data) != 1:
        return Reject.LENGTH
    return data[0] if 1 <= data[0] <= counter_max else Reject.SEQUENCE


def encode_sync(counter: int) -> tuple[int, bytes]:
    """Return COB-ID and data of a SYNC with its counter."""
    return COB_SYNC, bytes((counter,))


def encode_nmt(command: NmtCommand, node_id: int) -> tuple[int, bytes]:
    """Return COB-ID and data of an NMT command; node 0 addresses all."""
    return COB_NMT, bytes((command, node_id))


def encode_heartbeat(state: NmtState, node_id: int) -> tuple[int, bytes]:
    """Return COB-ID and data of a heartbeat."""
    return COB_HEARTBEAT + node_id, bytes((state,))
