"""CANopen joint nodes: CiA 301/402 objects over ECSS-E-ST-50-15C services, little-endian.

Pure functions convert between bytes and values of the services; `fsw.drivers.layout` reads PDOs.
Identifiers are bare 11-bit COB-IDs.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from fsw.drivers.wire import Reject

COB_NMT = 0x000
COB_SYNC = 0x080
COB_EMCY = 0x080  # + node
COB_TPDO1 = 0x180  # + node
COB_TPDO2 = 0x280  # + node
COB_HEARTBEAT = 0x700  # + node
MASTER_NODE = 0x01
FUNCTION_MASK = 0x780
NODE_MASK = 0x07F

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
    """Return COB-ID and data of a SYNC with its counter; 0: without data."""
    return COB_SYNC, bytes((counter,)) if counter else b""


def encode_nmt(command: NmtCommand, node_id: int) -> tuple[int, bytes]:
    """Return COB-ID and data of an NMT command; node 0 addresses all."""
    return COB_NMT, bytes((command, node_id))


def encode_heartbeat(state: NmtState, node_id: int) -> tuple[int, bytes]:
    """Return COB-ID and data of a heartbeat."""
    return COB_HEARTBEAT + node_id, bytes((state,))
