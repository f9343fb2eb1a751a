"""CAN FD drives whose frames have the time of the drive's own clock, which drifts and wraps.

29-bit identifiers; twelve bytes: position [mrad] and torque [mN m] as signed integers in steps of
0.001, big-endian, the clock [us] of 16 bits, which wraps after 65 ms, and two bytes of state.
"""

import struct
from typing import Any

from hil.devices.dialects import EXTENDED, Dialect, Frame, Measured

FIRST_ID = 0x18FF0000
STEP = 1e-6  # rad and N m
RESPONSE_NS = 30_000.0
STAMP_S = 5e-6


def _encode(node: int, own: Measured) -> list[Frame]:
    position, torque = round(own.position_rad / STEP), round(own.torque_nm / STEP)
    data = struct.pack(">iiHH", position, torque, own.clock_us & 0xFFFF, 1)
    return [Frame(RESPONSE_NS, EXTENDED | FIRST_ID | node, data, is_fd=True)]


def _messages(node: int) -> list[dict[str, Any]]:
    signals = [
        {"name": name, "start": start, "bits": 32, "order": "big", "number": "signed"}
        | {"scale": 1e-3, "unit": unit}
        for name, start, unit in (("position", 7, "mrad"), ("torque", 39, "mN m"))
    ]
    clock = {"name": "clock", "start": 71, "bits": 16, "order": "big", "unit": "us"}
    message = {"name": f"drive{node}", "id": FIRST_ID | node, "extended": True, "length": 12}
    return [message | {"signals": [*signals, clock]}]


def _joint(node: int) -> dict[str, Any]:
    message = f"drive{node}"
    return {
        "signals": {
            "position": {"message": message, "signal": "position"},
            "torque": {"message": message, "signal": "torque"},
            "time": {"message": message, "signal": "clock"},
        },
        "timing": {"by": "device_time", "sigma_s": STAMP_S, "delay_s": RESPONSE_NS * 1e-9},
    }


DIALECT = Dialect(
    trigger="timer",
    encode=_encode,
    messages=_messages,
    joint=_joint,
    bus={
        "sync": "none",
        "listen_only": True,
        "fd": True,
        "bitrate": 1_000_000,
        "data_bitrate": 5_000_000,
    },
    torque_step_nm=STEP,
    position_step_rad=STEP,
)
