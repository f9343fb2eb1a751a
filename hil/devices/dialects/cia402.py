"""CANopen drives of the profile CiA 402: PDOs of transmission type 1, SYNC without data, no echo.

TPDO1 has the status word (0x6041) and the torque (0x6077) in per mille of the rated one, TPDO3 the
position (0x6064) in counts of an encoder and the speed (0x606C). Identifiers are the predefined
ones.
"""

import math
import struct
from typing import Any

from hil.devices.dialects import Dialect, Frame, Measured

TPDO1, TPDO3 = 0x180, 0x380
COUNTS_PER_REV = 2**22
RATED_TORQUE_NM = 20.0
ENABLED = 0x0237  # voltage, quick stop, operation enabled, remote
RESPONSE_NS = 60_000.0  # SYNC to the first PDO ready
GAP_NS = 20_000.0


def _encode(node: int, own: Measured) -> list[Frame]:
    permille = round(own.torque_nm / RATED_TORQUE_NM * 1000)
    permille = max(-(2**15), min(2**15 - 1, permille))
    counts = round(own.position_rad / math.tau * COUNTS_PER_REV)
    speed = round(own.speed_rad_s / math.tau * COUNTS_PER_REV)
    return [
        Frame(RESPONSE_NS, TPDO1 + node, struct.pack("<Hh", ENABLED, permille)),
        Frame(RESPONSE_NS + GAP_NS, TPDO3 + node, struct.pack("<ii", counts, speed)),
    ]


def _messages(node: int) -> list[dict[str, Any]]:
    return [
        {
            "name": f"node{node}_tpdo1",
            "id": TPDO1 + node,
            "length": 4,
            "signals": [
                {"name": "statusword", "start": 0, "bits": 16},
                {"name": "torque", "start": 16, "bits": 16, "number": "signed"},
            ],
        },
        {
            "name": f"node{node}_tpdo3",
            "id": TPDO3 + node,
            "length": 8,
            "signals": [
                {"name": "position", "start": 0, "bits": 32, "number": "signed"},
                {"name": "speed", "start": 32, "bits": 32, "number": "signed"},
            ],
        },
    ]


def _joint(node: int) -> dict[str, Any]:
    first, third = f"node{node}_tpdo1", f"node{node}_tpdo3"
    return {
        "signals": {
            "position": {
                "message": third,
                "signal": "position",
                "unit": "counts",
                "counts_per_rev": float(COUNTS_PER_REV),
            },
            "torque": {
                "message": first,
                "signal": "torque",
                "unit": "permille",
                "rated_torque_nm": RATED_TORQUE_NM,
            },
            "status": {"message": first, "signal": "statusword", "mask": 0x6F, "value": 0x27},
        },
        "timing": {"by": "last_sync"},
    }


DIALECT = Dialect(
    trigger="sync",
    encode=_encode,
    messages=_messages,
    joint=_joint,
    bus={"sync": "producer", "sync_counter_max": 0},
    torque_step_nm=RATED_TORQUE_NM / 1000,
    position_step_rad=math.tau / COUNTS_PER_REV,
)
