"""Thruster nodes: TPDO1 of valve drivers, little-endian; other services are as for joint nodes.

Pure functions convert between bytes and values.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.messages import IntArray

AGE_SCALE_NS = 10_000
OLD = 0xFFFF  # age on the wire: the newest change is this old or older, or there was none
STATUS_OF_VALVES = 0xD8  # valves valid, driver fault, SYNC lost, test data
STATUS_VALVES_VALID = 0x08
TPDO1_BYTES = 8
_TPDO1 = np.dtype("<u2, <u2, u1, u1, u1, u1")


@dataclass(frozen=True, slots=True, eq=False)
class ThrusterTpdo1:
    """Latched states of valve drivers; all arrays (k,)."""

    valves: IntArray  # one bit for each valve, 1: open
    age_ns: IntArray  # age of the newest change at the latch; -1: OLD
    changes: IntArray  # number of instants at which any valve changed, modulo 256
    status: IntArray
    sync_counter: IntArray


def valves_usable(status: IntArray) -> NDArray[np.bool_]:
    """Return (k,) whether valve states are valid and no fault or test data is flagged."""
    return np.asarray(status & STATUS_OF_VALVES == STATUS_VALVES_VALID)


def decode_tpdo1(data: NDArray[np.uint8]) -> ThrusterTpdo1:
    """Decode the data (k, 8) of TPDO1 frames."""
    raw = np.ascontiguousarray(data).view(_TPDO1)[:, 0]
    valves, age, changes, _, status, counter = (raw[f"f{k}"].astype(np.int64) for k in range(6))
    age_ns = np.where(age == OLD, -1, age * AGE_SCALE_NS)
    return ThrusterTpdo1(valves, age_ns, changes, status, counter)
