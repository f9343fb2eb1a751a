"""CANopen joint nodes: CiA 301/402 objects over ECSS-E-ST-50-15C services, little-endian.

Pure functions between the data of one frame and one value; identifiers are bare 11-bit COB-IDs.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum

from fsw.drivers.wire import Reject

COB_NMT = 0x000
COB_SYNC = 0x080
COB_EMCY = 0x080  # + node
COB_TPDO1 = 0x180  # + node
COB_TPDO2 = 0x280  # + node
COB_SDO_REPLY = 0x580  # + node
COB_SDO_REQUEST = 0x600  # + node
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
# a braked joint is held, its readings are real
STATUS_OF_POSITION = 0xFF & ~STATUS_OF_TORQUE & ~STATUS_BRAKE_ENGAGED

_TPDO1 = struct.Struct("<ihBB")
_FD = struct.Struct("<iiiHBbI")
_TPDO2 = struct.Struct("<ihh")


class NmtCommand(IntEnum):
    """Commands of the NMT master."""

    START = 0x01
    STOP = 0x02
    PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class NmtState(IntEnum):
    """States a heartbeat reports."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


@dataclass(frozen=True, slots=True)
class Tpdo1:
    """Latched link-side values of one joint, uncalibrated."""

    position_rad: float
    torque_nm: float
    status: int
    sync_counter: int


@dataclass(frozen=True, slots=True)
class FdTpdo1:
    """CAN FD tailoring of TPDO1."""

    position_rad: float
    velocity_rad_s: float
    torque_nm: float
    status: int
    sync_counter: int
    temperature_c: float
    device_time_us: int


@dataclass(frozen=True, slots=True)
class Tpdo2:
    """Slow channel of one joint; motor torque as a ratio of the rated torque."""

    velocity_rad_s: float
    motor_torque_ratio: float
    temperature_c: float


@dataclass(frozen=True, slots=True)
class Emergency:
    """EMCY object: error code, error register, manufacturer's bytes."""

    code: int
    register: int
    detail: bytes


def position_usable(status: int) -> bool:
    """Return whether the position is valid and real; the brake does not matter."""
    return status & STATUS_OF_POSITION == STATUS_ENCODER_VALID


def torque_usable(status: int) -> bool:
    """Return whether the torque is valid and no fault of its sensor is flagged."""
    return status & STATUS_OF_TORQUE == STATUS_TORQUE_VALID


def decode_tpdo1(data: bytes) -> Tpdo1 | Reject:
    """Decode the classic 8-byte TPDO1."""
    if len(data) != _TPDO1.size:
        return Reject.LENGTH
    position, torque, status, counter = _TPDO1.unpack(data)
    return Tpdo1(position * POSITION_SCALE_RAD, torque * TORQUE_SCALE_NM, status, counter)


def decode_fd(data: bytes) -> FdTpdo1 | Reject:
    """Decode the 20-byte CAN FD tailoring of TPDO1."""
    if len(data) != _FD.size:
        return Reject.LENGTH
    position, velocity, torque, status, counter, temperature, time_us = _FD.unpack(data)
    return FdTpdo1(
        position * POSITION_SCALE_RAD,
        velocity * POSITION_SCALE_RAD,
        torque * FD_TORQUE_SCALE_NM,
        status,
        counter,
        float(temperature),
        time_us,
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
    """Return the node's state (an `NmtState` where it is a known one); 0 is the boot-up message."""
    if len(data) != 1:
        return Reject.LENGTH
    return data[0] & 0x7F


def decode_emcy(data: bytes) -> Emergency | Reject:
    """Decode an emergency object; code 0 means the error is reset."""
    if len(data) != 8:
        return Reject.LENGTH
    return Emergency(int.from_bytes(data[:2], "little"), data[2], data[3:])


def decode_sync(data: bytes, counter_max: int) -> int | Reject:
    """Return the counter of a SYNC."""
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
