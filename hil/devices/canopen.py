"""A CANopen joint node: its wire formats and its network state (CiA 301 objects).

Source: the project's ICD; values are little-endian. Written independently of the flight decoder.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.devices.bus_toggle import BusToggle
from hil.devices.tpdo1 import CLASSIC, FD

SYNC_ID = 0x080
NMT_ID = 0x000
SDO_ID = 0x600  # identifiers from here: requests to a node, then heartbeats
COUNTS_PER_RAD = 2**24 / (2.0 * math.pi)
COUNTS_PER_M = 2**24
STATUS_GOOD = 0x09  # torque valid, encoder valid
STATUS_TORQUE = 0x01
STATUS_OVERLOAD = 0x02
TPDO2_PERIOD = 10  # SYNCs
TPDO2 = struct.Struct("<ihh")
TEMPERATURE_DEGC = 25
ABORT_NO_OBJECT = 0x06020000
ABORT_NO_SUBINDEX = 0x06090011
ABORT_READ_ONLY = 0x06010002
ABORT_COMMAND = 0x05040001


class NodeState(IntEnum):
    """Network state as coded in the heartbeat."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class Reading(NamedTuple):
    """Measurement of a node at one latch, as raw values of frame fields."""

    position: int  # 2^-24 rev; prismatic joint: 2^-24 m (velocity: m/s, torque: N)
    velocity: int  # 2^-24 rev/s
    torque: int  # 0.01 N m; CAN FD node: 1e-4 N m
    motor_torque: int  # per mille of the rated torque
    is_overloaded: bool


class FieldScale:
    """Converts measured values of all nodes to raw values of frame fields."""

    def __init__(
        self, is_fd: Sequence[bool], torque_range_nm: float, is_sliding: Sequence[bool] = ()
    ) -> None:
        forms = [FD if fd else CLASSIC for fd in is_fd]
        one = np.ones(len(forms))
        per_nm = np.array([form.counts_per_nm for form in forms])
        tops = [2.0 ** (form.torque_bits - 1) - 1.0 for form in forms]
        position_top, motor_top = (2.0**31 - 1.0) * one, (2.0**15 - 1.0) * one
        counts = COUNTS_PER_RAD * one
        counts[np.flatnonzero(is_sliding)] = COUNTS_PER_M
        scale = np.stack([counts, counts, per_nm, 1000.0 * one])
        top = np.stack([position_top, position_top, np.array(tops), motor_top])
        self._scale, self._top = scale[:, None], top[:, None]
        self._bottom = -self._top - 1.0
        self._range_nm = torque_range_nm

    def readings(self, measured: NDArray[np.float64]) -> list[list[Reading]]:
        """Return for each latch a reading of every node; values beyond a field saturate.

        Parameters
        ----------
        measured : (4, k, n) position [rad], velocity [rad/s], torque [N m], and motor torque as a
            share of the rated torque, at k latches, in sign and zero of the node
        """
        fields = np.rint(measured * self._scale)
        np.minimum(np.maximum(fields, self._bottom, out=fields), self._top, out=fields)
        overloaded = np.abs(measured[2]) > self._range_nm
        columns = [*fields.astype(np.int64).tolist(), overloaded.tolist()]
        return [
            list(map(Reading._make, zip(*latch, strict=True)))
            for latch in zip(*columns, strict=True)
        ]


def encode_tpdo1(reading: Reading, status: int, counter: int) -> bytes:
    """Return the 8 bytes of TPDO1: position, link torque, status, SYNC counter."""
    return CLASSIC.form.pack(reading.position, reading.torque, status & 0xFF, counter)


def encode_fd(reading: Reading, status: int, counter: int, device_time_us: int) -> bytes:
    """Return the 20 bytes of the CAN FD tailoring of TPDO1."""
    return FD.form.pack(
        reading.position,
        reading.velocity,
        reading.torque,
        status & 0xFFFF,
        counter,
        TEMPERATURE_DEGC,
        device_time_us & 0xFFFFFFFF,
    )


def encode_tpdo2(reading: Reading) -> bytes:
    """Return the 8 bytes of TPDO2: velocity, motor torque, temperature."""
    return TPDO2.pack(reading.velocity, reading.motor_torque, 10 * TEMPERATURE_DEGC)


def encode_emergency(code: int, register: int, detail: bytes = b"") -> bytes:
    """Return the 8 bytes of an EMCY frame: error code, error register, manufacturer bytes."""
    return struct.pack("<HB", code, register) + detail[:5].ljust(5, b"\0")


@dataclass(slots=True)
class JointNode:
    """Network state of one node; `joint` counts from 1."""

    node_id: int
    joint: int
    is_fd: bool = False
    torque_sensor: bool = True
    autostart: bool = True
    sync_counter_max: int = 240
    state: NodeState = NodeState.PRE_OPERATIONAL
    status_extra: int = 0  # further status bits, set by faults
    silent: bool = False  # true: the node sends nothing
    toggle: BusToggle | None = None  # only for a node on two buses
    syncs_per_report: int = 1  # object 0x3018 of wheel and thruster nodes
    _syncs: int = 0
    _commanded: bool = False
    _syncs_left: int | None = None  # SYNCs until the next TPDO2; None: start value not received yet
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
        """Bus of a redundant pair, 0 or 1, on which the node receives and sends."""
        return 0 if self.toggle is None else self.toggle.line

    def on_nmt(self, command: int, node_id: int) -> bool:
        """Apply an NMT command; return True if the node restarts and so sends a boot-up frame."""
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

    def on_sync(self, counter: int, reading: Reading, t_us: int) -> tuple[bytes, ...]:
        """Return the PDOs that this SYNC triggers: none, TPDO1, or TPDO1 and TPDO2."""
        if not self._reports():
            return ()
        status = STATUS_GOOD | self.status_extra
        if not self.torque_sensor:
            reading, status = reading._replace(torque=0), status & ~STATUS_TORQUE
        elif reading.is_overloaded:
            status |= STATUS_OVERLOAD
        if self.is_fd:
            return (encode_fd(reading, status, counter, t_us),)
        if self._tpdo2_due(counter):
            return encode_tpdo1(reading, status, counter), encode_tpdo2(reading)
        return (encode_tpdo1(reading, status, counter),)

    def _reports(self) -> bool:
        """Start if autostart allows, count one SYNC, return whether the node answers this SYNC."""
        if self.state is NodeState.PRE_OPERATIONAL and self.autostart and not self._commanded:
            self.state = NodeState.OPERATIONAL
        self._syncs += 1
        answers = self.state is NodeState.OPERATIONAL and not self.silent
        return answers and self._syncs % self.syncs_per_report == 0

    def _tpdo2_due(self, counter: int) -> bool:
        """Return whether TPDO2 is due; its start value 0x1801:06 is `joint` (CiA 301 7.5.2.37)."""
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
        """Return the answer to an SDO request: expedited upload or abort; None: no answer."""
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
