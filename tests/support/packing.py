"""Telemetry packets packed from the dictionary by `struct` alone, with random values."""

import binascii
import struct
from typing import Any

import numpy as np

from fsw.telemetry.dictionary import Field, Packet, Type

FORMATS = {
    Type.U8: "B",
    Type.U16: "H",
    Type.U32: "I",
    Type.U64: "Q",
    Type.I8: "b",
    Type.I16: "h",
    Type.I32: "i",
    Type.I64: "q",
    Type.F32: "f",
    Type.F64: "d",
}
TEXTS = ("", "a", "µm per °", "run 7: done", "x" * 200)


def random_value(item: Field, rng: np.random.Generator) -> Any:
    if item.enumeration is not None:
        return int(rng.choice(list(item.enumeration.labels)))
    if item.type is Type.TEXT:
        return str(rng.choice(TEXTS))[: item.size - 1]
    raw = rng.bytes(8)
    if item.type is Type.U24:
        return int.from_bytes(raw[:3], "big")
    (value,) = struct.unpack_from(">" + FORMATS[item.type], raw)
    return 0.5 if item.type in (Type.F32, Type.F64) and not np.isfinite(value) else value


def pack_value(item: Field, value: Any) -> bytes:
    if item.type is Type.TEXT:
        return value.encode().ljust(item.size, b"\0")
    if item.type is Type.U24:
        return value.to_bytes(3, "big")
    return struct.pack(">" + FORMATS[item.type], value)


def random_values(packet: Packet, rng: np.random.Generator) -> dict[str, Any]:
    match = dict(packet.match)
    return {item.name: match.get(item.name, random_value(item, rng)) for item in packet.fields}


def pack(packet: Packet, values: dict[str, Any], count: int = 0, met_s: float = 1.5) -> bytes:
    """Return a whole packet."""
    body = b"".join(pack_value(item, values[item.name]) for item in packet.fields)
    if packet.secondary_header:
        body = (
            struct.pack(">BBBHH", 0x20, packet.service, packet.subtype, count, 0)
            + b"\x2f"
            + round(met_s * 2**24).to_bytes(7, "big")
            + body
        )
    packet_id = packet.secondary_header << 11 | packet.apid
    head = struct.pack(">HHH", packet_id, 0xC000 | count, len(body) + 1)
    return head + body + binascii.crc_hqx(head + body, 0xFFFF).to_bytes(2, "big")
