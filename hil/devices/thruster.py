"""A thruster node: wire format and state. Source: the ICD, independent of the decoder."""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hil.devices.canopen import JointNode, Reading

TPDO1 = struct.Struct("<HHBBBB")
AGE_STEPS_PER_S = 1e5
OLD = 0xFFFF
STATUS_GOOD = 0x08  # valves valid


def encode_tpdo1(
    valves: Sequence[bool], age_s: float | None, changes: int, status: int, counter: int
) -> bytes:
    """Return the 8 bytes of TPDO1.

    Parameters
    ----------
    valves : states of the node's valves, bit 0 first; True: open
    age_s : age of the newest change at the latch; None: no change yet
    changes : number of instants at which any valve changed
    """
    word = sum(1 << k for k, is_open in enumerate(valves) if is_open)
    age = OLD if age_s is None else min(OLD, round(age_s * AGE_STEPS_PER_S))
    return TPDO1.pack(word, age, changes & 0xFF, 0, status & 0xFF, counter)


@dataclass(slots=True, kw_only=True)
class ThrusterNode(JointNode):
    """Network state of one valve driver; all services except the PDO are as in a joint node."""

    look: Callable[[], tuple[list[bool], float | None, int]]  # arguments of `encode_tpdo1`

    def on_sync(self, counter: int, _reading: Reading, _t_us: int) -> tuple[bytes, ...]:
        """Return the PDO that this SYNC triggers: none or TPDO1."""
        if not self._reports():
            return ()
        return (encode_tpdo1(*self.look(), STATUS_GOOD | self.status_extra, counter),)
