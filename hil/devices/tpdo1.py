"""TPDO1 of joint nodes, classic and CAN FD: layout, and access to fields of a frame."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Field = Literal["position", "torque", "status", "counter"]


def clamp(value: float, bits: int) -> int:
    """Return the nearest integer that a signed field of `bits` bits can hold."""
    top = 2 ** (bits - 1) - 1
    return int(max(-top - 1, min(top, round(value))))


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of one form of the frame."""

    form: struct.Struct
    places: dict[Field, int]  # index among the unpacked values
    torque_bits: int
    counts_per_nm: float

    def read(self, data: bytes, name: Field) -> int:
        """Return the raw value of a field."""
        return int(self.form.unpack(data)[self.places[name]])

    def written(self, data: bytes, fields: Mapping[Field, float]) -> bytes:
        """Return the frame with some raw fields replaced; position and torque are clamped."""
        values = list(self.form.unpack(data))
        bits = {"position": 32, "torque": self.torque_bits}
        for name, value in fields.items():
            values[self.places[name]] = clamp(value, bits[name]) if name in bits else value
        return self.form.pack(*values)


CLASSIC = Layout(
    struct.Struct("<ihBB"), {"position": 0, "torque": 1, "status": 2, "counter": 3}, 16, 100.0
)
FD = Layout(
    struct.Struct("<iiiHBbI"), {"position": 0, "torque": 2, "status": 3, "counter": 4}, 32, 1e4
)


def layout(data: bytes) -> Layout | None:
    """Return the layout of a frame by its length; None for another length."""
    return next((form for form in (CLASSIC, FD) if len(data) == form.form.size), None)
