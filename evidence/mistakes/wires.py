"""The joints of a mistake's readings on a CAN bus that a description gives.

One frame of each joint, encoded here: angle in steps of 0.0001 deg, torque in steps of 0.01 N m,
speed in steps of 0.01 deg/s; all signed and little-endian. The drives send by timers of their own.
"""

import copy
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from hil.world.inertia import FloatArray

FIRST_ID = 0x201
WIRE_S = 1.2e-4  # least time from the measurement to the stamp of the frame
LATE_S = 2.0e-5  # mean of what is added to it
SIGNALS = (  # name, first bit, bits, size of a step, unit
    ("angle", 0, 32, 1e-4, "deg"),
    ("torque", 32, 16, 1e-2, "N m"),
    ("speed", 48, 16, 1e-2, "deg/s"),
)
_FRAME = struct.Struct("<ihh")


def frames(
    joint: int, t_s: FloatArray, q_rad: FloatArray, tau_nm: FloatArray, rng: np.random.Generator
) -> list[tuple[float, str]]:
    """Return stamp [s] and text of a joint's frames."""
    columns = (np.degrees(q_rad), tau_nm, np.degrees(np.gradient(q_rad, t_s)))
    steps = [np.rint(own / step[3]) for own, step in zip(columns, SIGNALS, strict=True)]
    stamps = t_s + WIRE_S + rng.exponential(LATE_S, len(t_s))
    rows = zip(stamps.tolist(), *(own.astype(int).tolist() for own in steps), strict=True)
    return [
        (at, f"can0 {FIRST_ID + joint:03X}#{_FRAME.pack(*own).hex().upper()}") for at, *own in rows
    ]


def write_candump(path: Path, sent: Iterable[tuple[float, str]], epoch_s: float) -> None:
    """Write frames as candump does; `epoch_s` is added to their stamps."""
    path.write_text("".join(f"({epoch_s + t:.6f}) {frame}\n" for t, frame in sorted(sent)))


def describe(document: dict[str, Any], rate_hz: float) -> None:
    """Make a configuration read such frames, one bus with all joints."""
    signals = [
        {"name": name, "start": start, "bits": bits, "scale": step, "unit": unit}
        | {"number": "signed"}
        for name, start, bits, step, unit in SIGNALS
    ]
    document["buses"] = [
        {"name": "arm", "interface": "socketcan", "channel": "can0", "rate_hz": rate_hz}
        | {"sync": "none", "listen_only": True}
        | {
            "messages": [
                {"name": f"drive{k}", "id": FIRST_ID + k, "length": 8}
                | {"signals": copy.deepcopy(signals)}
                for k in range(len(document["joints"]))
            ]
        }
    ]
    for k, joint in enumerate(document["joints"]):
        joint.pop("node_id", None)
        joint.pop("format", None)
        joint |= {
            "bus": "arm",
            "driver": "described",
            "position_noise_rad": max(joint["position_noise_rad"], 1e-6),
            "signals": {
                "position": {"message": f"drive{k}", "signal": "angle"},
                "torque": {"message": f"drive{k}", "signal": "torque"},
            },
            "timing": {"by": "arrival", "sigma_s": LATE_S},
        }
    document["scheduler"]["tick_rate_hz"] = rate_hz
