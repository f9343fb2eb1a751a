"""Telemetry packets as CSV tables for ccsdspy, one file per packet.

ccsdspy reads the first four columns; unit, limits and labels that need attention follow.
"""

import csv
import io

from fsw.telemetry.dictionary import Field, Packet, Type
from offline.exports.xtce import CRC_BITS, FLOATS, SECONDARY, SIGNED

PRIMARY_BITS = 48  # ccsdspy itself reads the primary header
BOUNDS = ("red_low", "yellow_low", "yellow_high", "red_high")


def table(packet: Packet) -> str:
    """Return CSV rows of all fields after the primary header; length and offset are in bits."""
    rows: list[tuple[str, str, int, Field | None]] = []
    if packet.secondary_header:
        rows += [(f"header_{name}", "uint", bits, None) for name, bits in SECONDARY]
    rows += [(item.name, _kind(item), 8 * item.size_bytes, item) for item in packet.fields]
    rows.append(("crc16", "uint", CRC_BITS, None))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("name", "data_type", "bit_length", "bit_offset", "unit", *BOUNDS, "alarms"))
    at = PRIMARY_BITS
    for name, kind, bits, item in rows:
        writer.writerow((name, kind, bits, at, *_attention(item)))
        at += bits
    return text.getvalue()


def _attention(item: Field | None) -> tuple[str, ...]:
    """Return unit, limits, and labels with their colour; empty texts for missing ones."""
    if item is None:
        return ("",) * (len(BOUNDS) + 2)
    bounds = (None if item.limits is None else getattr(item.limits, name) for name in BOUNDS)
    alarms = " ".join(f"{label}:{concern.name.lower()}" for label, concern in item.alarms)
    return (item.unit, *("" if bound is None else f"{bound:.17g}" for bound in bounds), alarms)


def _kind(item: Field) -> str:
    if item.type is Type.TEXT:
        return "str"
    if item.type in FLOATS:
        return "float"
    return "int" if item.type in SIGNED else "uint"
