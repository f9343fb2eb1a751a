"""Drives that report by timers of their own: two frames each, no SYNC, no counter, no time.

The layout is that of a widespread open drive: identifiers `axis << 5 | command`, command 0x09 with
position [rev] and speed [rev/s], 0x1C with a target and the estimate of the torque [N m], all
little-endian floats of 32 bits.
"""

import math
import struct
from collections.abc import Sequence
from typing import Any

from hil.devices.dialects import Dialect, Frame, Measured

ENCODER, TORQUES = 0x09, 0x1C
RESPONSE_NS = 30_000.0  # measurement to the first frame ready
GAP_NS = 40_000.0  # between the two frames of a drive
STAMP_S = 5e-6  # 1 sigma of a stamp that a line under the arrivals gives
_FLOATS = struct.Struct("<ff")


def _encode(node: int, own: Measured) -> list[Frame]:
    turns = _FLOATS.pack(own.position_rad / math.tau, own.speed_rad_s / math.tau)
    torques = _FLOATS.pack(0.0, own.torque_nm)
    return [
        Frame(RESPONSE_NS, node << 5 | ENCODER, turns),
        Frame(RESPONSE_NS + GAP_NS, node << 5 | TORQUES, torques),
    ]


def _messages(node: int) -> list[dict[str, Any]]:
    def pair(command: int, name: str, fields: Sequence[str]) -> dict[str, Any]:
        return {
            "name": f"axis{node}_{name}",
            "id": node << 5 | command,
            "length": 8,
            "signals": [
                {"name": field, "start": 32 * k, "bits": 32, "number": "float"}
                for k, field in enumerate(fields)
            ],
        }

    return [
        pair(ENCODER, "encoder", ("position", "speed")),
        pair(TORQUES, "torques", ("target", "estimate")),
    ]


def _joint(node: int) -> dict[str, Any]:
    return {
        "signals": {
            "position": {"message": f"axis{node}_encoder", "signal": "position", "unit": "rev"},
            "torque": {"message": f"axis{node}_torques", "signal": "estimate", "unit": "N m"},
        },
        "timing": {"by": "arrival", "sigma_s": STAMP_S, "delay_s": RESPONSE_NS * 1e-9},
    }


DIALECT = Dialect(trigger="timer", encode=_encode, messages=_messages, joint=_joint)
