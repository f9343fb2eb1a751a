"""Motors that reply to the commands of another master: 16 bits of position, 12 of speed and torque.

Byte 0 is the motor's number, then position, speed and torque follow without gaps, most significant
bit first. Each is a share of a range that is a setting of the motor. The other master's command
has the motor's number as identifier and has the same form.
"""

from typing import Any

from hil.devices.dialects import Dialect, Frame, Measured

REPLY_ID = 0x100
RANGES = {"position": (16, 4.0), "speed": (12, 8.0), "torque": (12, 60.0)}  # bits, +- range
REPLY_NS = 180_000.0  # command received, which is when the motor measures, to the reply ready
STAMP_S = 1e-5  # 1 sigma of a stamp of the master's command


def _share(value: float, bits: int, top: float) -> int:
    steps = (1 << bits) - 1
    return max(0, min(steps, round((value + top) / (2.0 * top) * steps)))


def _encode(node: int, own: Measured) -> list[Frame]:
    values = (own.position_rad, own.speed_rad_s, own.torque_nm)
    word = 0
    for value, (bits, top) in zip(values, RANGES.values(), strict=True):
        word = word << bits | _share(value, bits, top)
    return [Frame(REPLY_NS, REPLY_ID + node, bytes([node & 0xFF]) + word.to_bytes(5, "big"))]


def _command(node: int) -> Frame:
    return Frame(0.0, node, bytes.fromhex("7fff7ff0000007ff"))


def _messages(node: int) -> list[dict[str, Any]]:
    signals = []
    for start, (name, (bits, top)) in zip((15, 31, 35), RANGES.items(), strict=True):
        signal = {"name": name, "start": start, "bits": bits, "order": "big"}
        signals.append(signal | {"range": [-top, top]})
    return [{"name": f"motor{node}", "id": REPLY_ID + node, "length": 6, "signals": signals}]


def _joint(node: int) -> dict[str, Any]:
    return {
        "signals": {
            "position": {"message": f"motor{node}", "signal": "position", "unit": "rad"},
            "torque": {"message": f"motor{node}", "signal": "torque", "unit": "N m"},
        },
        "timing": {"by": "request", "requests": [node], "sigma_s": STAMP_S},
    }


def _step(name: str) -> float:
    bits, top = RANGES[name]
    return 2.0 * top / ((1 << bits) - 1)


DIALECT = Dialect(
    trigger="command",
    encode=_encode,
    command=_command,
    messages=_messages,
    joint=_joint,
    torque_step_nm=_step("torque"),
    position_step_rad=_step("position"),
)
