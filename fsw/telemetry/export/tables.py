"""Telemetry packets as CSV tables for ccsdspy, one file per packet."""

from __future__ import annotations

import csv
import io

from fsw.telemetry.dictionary import Field, Packet, Type
from fsw.telemetry.export.xtce import CRC_BITS, FLOATS, SECONDARY, SIGNED

PRIMARY_BITS = 48  # ccsdspy reads the primary header by itself


def table(packet: Packet) -> str:
    """Return the fields after the primary header: name, type, length and place [bits]."""
    rows: list[tuple[str, str, int]] = []
    if packet.secondary_header:
        rows += [(f"header_{name}", "uint", bits) for name, bits in SECONDARY]
    rows += [(item.name, _kind(item), 8 * item.size_bytes) for item in packet.fields]
    rows.append(("crc16", "uint", CRC_BITS))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("name", "data_type", "bit_length", "bit_offset"))
    at = PRIMARY_BITS
    for name, kind, bits in rows:
        writer.writerow((name, kind, bits, at))
        at += bits
    return text.getvalue()


def _kind(item: Field) -> str:
    if item.type is Type.TEXT:
        return "str"
    if item.type in FLOATS:
        return "float"
    return "int" if item.type in SIGNED else "uint"
