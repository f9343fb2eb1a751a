"""A CANopen joint node: its wire formats and its network state (CiA 301 objects).

Source: the project's ICD; values are little-endian. Written independently of the flight decoder.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from enum import IntEnum

from hil.devices.bus_toggle import BusToggle
from hil.devices.tpdo1 import CLASSIC, FD, clamp

SYNC_ID = 0x080
NMT_ID = 0x000
SDO_ID = 0x600  # and above: requests to a node, then heartbeats
COUNTS_PER_RAD = 2**24 / (2.0 * math.pi)
STATUS_GOOD = 0x09  # torque valid, encoder valid
STATUS_OVERLOAD = 0x02
TPDO2_PERIOD = 10  # SYNCs
ABORT_NO_OBJECT = 0x06020000
ABORT_NO_SUBINDEX = 0x06090011
ABORT_READ_ONLY = 0x06010002
ABORT_COMMAND = 0x05040001


class NodeState(IntEnum):
    """Network state as the heartbeat carries it."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


@dataclass(frozen=True, slots=True)
class Reading:
    """Measurement of a node at one latch, in its own sign and zero."""

    position_rad: float
    velocity_rad_s: float
    torque_nm: float
    motor_torque_ratio: float  # of rated
    temperature_degc: float


def encode_tpdo1(reading: Reading, status: int, counter: int) -> bytes:
    """Return the 8 bytes of TPDO1: position, link torque, status, SYNC counter."""
    return CLASSIC.form.pack(
        clamp(reading.position_rad * COUNTS_PER_RAD, 32),
        clamp(reading.torque_nm * CLASSIC.counts_per_nm, CLASSIC.torque_bits),
        status & 0xFF,
        counter,
    )


def encode_fd(reading: Reading, status: int, counter: int, device_time_us: int) -> bytes:
    """Return the 20 bytes of the CAN FD tailoring of TPDO1."""
    return FD.form.pack(
        clamp(reading.position_rad * COUNTS_PER_RAD, 32),
        clamp(reading.velocity_rad_s * COUNTS_PER_RAD, 32),
        clamp(reading.torque_nm * FD.counts_per_nm, FD.torque_bits),
        status & 0xFFFF,
        counter,
        clamp(reading.temperature_degc, 8),
        device_time_us & 0xFFFFFFFF,
    )


def encode_tpdo2(reading: Reading) -> bytes:
    """Return the 8 bytes of TPDO2: velocity, motor torque, temperature."""
    return struct.pack(
        "<ihh",
        clamp(reading.velocity_rad_s * COUNTS_PER_RAD, 32),
        clamp(reading.motor_torque_ratio * 1000.0, 16),
        clamp(reading.temperature_degc * 10.0, 16),
    )


def encode_emergency(code: int, register: int, detail: bytes = b"") -> bytes:
    """Return the 8 bytes of an EMCY frame: error code, error register, manufacturer bytes."""
    return struct.pack("<HB", code, register) + detail[:5].ljust(5, b"\0")


@dataclass(slots=True)
class JointNode:
    """Network state of one node; `joint` counts from 1."""

    node_id: int
    joint: int
    is_fd: bool = False
    autostart: bool = True
    sync_counter_max: int = 240
    state: NodeState = NodeState.PRE_OPERATIONAL
    status_extra: int = 0  # further status bits a fault scenario wants set
    silent: bool = False  # a dead node
    toggle: BusToggle | None = None  # of a node on two buses
    _commanded: bool = False
    _syncs_left: int | None = None  # until the next TPDO2; None: start value not seen yet
    _objects: dict[tuple[int, int], bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._objects = {
            (0x1000, 0): struct.pack("<I", 0x00020192),
            (0x1018, 0): b"\x04",
            (0x1018, 1): struct.pack("<I", 0),
            (0x1018, 2): struct.pack("<I", 1),
            (0x1018, 3): struct.pack("<I", 1),
            (0x1018, 4): struct.pack("<I", self.node_id),
            (0x1019, 0): bytes([self.sync_counter_max]),
        }

    @property
    def line(self) -> int:
        """Which bus of a pair the node listens and talks on."""
        return 0 if self.toggle is None else self.toggle.line

    def on_nmt(self, command: int, node_id: int) -> bool:
        """Apply an NMT command; True when the node restarted (and sends its boot-up frame)."""
        if node_id not in (0, self.node_id):
            return False
        if command in (0x81, 0x82):
            self.state = NodeState.PRE_OPERATIONAL
            self._commanded, self._syncs_left = False, None
            return True
        states = {
            0x01: NodeState.OPERATIONAL,
            0x02: NodeState.STOPPED,
            0x80: NodeState.PRE_OPERATIONAL,
        }
        if command in states:
            self.state, self._commanded = states[command], True
        return False

    def on_sync(self, counter: int, reading: Reading, t_us: int, status: int) -> dict[int, bytes]:
        """Return the PDOs this SYNC triggers, by COB-ID."""
        if self.state is NodeState.PRE_OPERATIONAL and self.autostart and not self._commanded:
            self.state = NodeState.OPERATIONAL
        if self.state is not NodeState.OPERATIONAL or self.silent:
            return {}
        status |= self.status_extra
        if self.is_fd:
            return {0x180 + self.node_id: encode_fd(reading, status, counter, t_us)}
        frames = {0x180 + self.node_id: encode_tpdo1(reading, status, counter)}
        if self._tpdo2_due(counter):
            frames[0x280 + self.node_id] = encode_tpdo2(reading)
        return frames

    def _tpdo2_due(self, counter: int) -> bool:
        """Count SYNCs from the start value (object 0x1801:06 = joint number), CiA 301 7.5.2.37."""
        if self._syncs_left is None:
            if counter != self.joint:
                return False
            self._syncs_left = TPDO2_PERIOD
        self._syncs_left -= 1
        if self._syncs_left:
            return False
        self._syncs_left = TPDO2_PERIOD
        return True

    def on_sdo(self, data: bytes) -> bytes | None:
        """Answer one SDO request (expedited upload only), else abort."""
        if self.silent or self.state is NodeState.STOPPED or len(data) != 8 or data[0] >> 5 == 4:
            return None
        index, subindex = struct.unpack_from("<HB", data, 1)
        objects = self._objects | ({} if self.toggle is None else self.toggle.objects())
        value = objects.get((index, subindex))
        if data[0] >> 5 == 2 and value is not None:
            flags = 0x43 | (4 - len(value)) << 2
            return struct.pack("<BHB", flags, index, subindex) + value.ljust(4, b"\0")
        known = any(key[0] == index for key in objects)
        if data[0] >> 5 not in (1, 2):
            code = ABORT_COMMAND
        elif not known:
            code = ABORT_NO_OBJECT
        else:
            code = ABORT_READ_ONLY if value is not None else ABORT_NO_SUBINDEX
        return struct.pack("<BHBI", 0x80, index, subindex, code)
