"""Where the fields of a TPDO1 lie, classic and CAN FD: for faults that are written into frames."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Field = Literal["position", "torque", "status", "counter"]
INT16 = -(2**15), 2**15 - 1
INT32 = -(2**31), 2**31 - 1


@dataclass(frozen=True, slots=True)
class Layout:
    """One form of the frame."""

    form: struct.Struct
    places: dict[Field, int]  # among the unpacked values
    ranges: dict[Field, tuple[int, int]]
    nm_per_count: float

    def read(self, data: bytes, name: Field) -> int:
        """Return a raw field."""
        return int(self.form.unpack(data)[self.places[name]])

    def written(self, data: bytes, fields: Mapping[Field, float]) -> bytes:
        """Return the frame with other raw fields, each the nearest that its place holds."""
        values = list(self.form.unpack(data))
        for name, value in fields.items():
            low, high = self.ranges[name]
            values[self.places[name]] = max(low, min(high, round(value)))
        return self.form.pack(*values)


CLASSIC = Layout(
    struct.Struct("<ihBB"),
    {"position": 0, "torque": 1, "status": 2, "counter": 3},
    {"position": INT32, "torque": INT16, "status": (0, 0xFF), "counter": (0, 0xFF)},
    0.01,
)
FD = Layout(
    struct.Struct("<iiiHBbI"),
    {"position": 0, "torque": 2, "status": 3, "counter": 4},
    {"position": INT32, "torque": INT32, "status": (0, 0xFFFF), "counter": (0, 0xFF)},
    1e-4,
)


def layout(data: bytes) -> Layout:
    """Return the layout of a frame that is whole."""
    return FD if len(data) == FD.form.size else CLASSIC
