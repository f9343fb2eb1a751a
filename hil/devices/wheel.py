"""A reaction wheel node: wire format and state. Source: the ICD, independent of the decoder."""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

from hil.devices.canopen import STATUS_GOOD, JointNode, Reading

COUNTS_PER_RAD_S = 2**24 / (2.0 * math.pi)
COUNTS_PER_NM = 1e4
TPDO1 = struct.Struct("<ihBB")
TPDO2_PERIOD = 10  # reports per TPDO2
TEMPERATURE_DEGC = 25
NO_JOINT = Reading(0, 0, 0, 0, False)


def encode_tpdo1(speed_rad_s: float, torque_nm: float, status: int, counter: int) -> bytes:
    """Return the 8 bytes of TPDO1: speed, motor torque, status, SYNC counter; fields saturate."""
    speed = _within(round(speed_rad_s * COUNTS_PER_RAD_S), 31)
    return TPDO1.pack(speed, _within(round(torque_nm * COUNTS_PER_NM), 15), status & 0xFF, counter)


def encode_tpdo2(temperature_degc: float) -> bytes:
    """Return the 2 bytes of TPDO2."""
    return struct.pack("<h", _within(round(10.0 * temperature_degc), 15))


def _within(count: int, bits: int) -> int:
    return int(max(-(2**bits), min(2**bits - 1, count)))


@dataclass(slots=True, kw_only=True)
class WheelNode(JointNode):
    """Network state of one wheel node; all services except the PDOs are as in a joint node."""

    measure: Callable[[], tuple[float, float]]  # speed [rad/s], motor torque [N m] at the latch
    _sent: int = 0

    def on_sync(self, counter: int, _reading: Reading, _t_us: int) -> tuple[bytes, ...]:
        """Return the PDOs that this SYNC triggers: none, TPDO1, or TPDO1 and TPDO2."""
        if not self._reports():
            return ()
        self._sent += 1
        first = encode_tpdo1(*self.measure(), STATUS_GOOD | self.status_extra, counter)
        if self._sent % TPDO2_PERIOD:
            return (first,)
        return first, encode_tpdo2(TEMPERATURE_DEGC)
