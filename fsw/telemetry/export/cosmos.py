"""The dictionary as COSMOS configuration: one target, `cmd.txt` and `tlm.txt`.

Items before the fields are the packet's headers; identifying ones carry their value.
"""

from __future__ import annotations

from collections.abc import Iterator

from fsw.telemetry.dictionary import Dictionary, Enumeration, Field, Packet, Telecommand, Type
from fsw.telemetry.dictionary.types import SIZE_BYTES
from fsw.telemetry.export.xtce import FLOATS, PRIMARY, SECONDARY, SIGNED
from fsw.telemetry.export.xtce_commands import (
    PUS_VERSION_ACK,
    TC_PACKET_ID,
    UNSEGMENTED,
    integer_range,
)

TARGET = "INERTIA"
FLOAT_BOUND = {Type.F32: "3.4e38", Type.F64: "1.7e308"}
CRC = "CRC16"


def telemetry(dictionary: Dictionary) -> str:
    """Return the telemetry definition."""
    return "\n\n".join("\n".join(_packet(packet)) for packet in dictionary.packets) + "\n"


def telecommands(dictionary: Dictionary) -> str:
    """Return the command definition."""
    return "\n\n".join("\n".join(_command(item)) for item in dictionary.telecommands) + "\n"


def _packet(packet: Packet) -> Iterator[str]:
    known = {"apid": packet.apid, "type": 0, "secondary_header": int(packet.secondary_header)}
    layout: tuple[tuple[str, int], ...] = PRIMARY
    if packet.secondary_header:
        known |= {"service": packet.service, "subtype": packet.subtype}
        layout += SECONDARY
    yield f"TELEMETRY {TARGET} {packet.name.upper()} BIG_ENDIAN {_quoted(packet.doc)}"
    for name, bits in layout:
        title = f"HEADER_{name.upper()}"
        if name in known:
            yield f'  APPEND_ID_ITEM {title} {bits} UINT {known[name]} ""'
        else:
            yield f'  APPEND_ITEM {title} {bits} UINT ""'
    match = dict(packet.match)
    for item in packet.fields:
        bits, kind = 8 * item.size_bytes, _kind(item)
        if item.name in match:
            yield (
                f"  APPEND_ID_ITEM {item.name.upper()} {bits} {kind} {match[item.name]} "
                f"{_quoted(item.doc)}"
            )
        else:
            yield f"  APPEND_ITEM {item.name.upper()} {bits} {kind} {_quoted(item.doc)}"
        yield from _details(item)
    yield f'  APPEND_ITEM {CRC} 16 UINT "CCITT-FALSE over all before"'


def _command(item: Telecommand) -> Iterator[str]:
    yield f"COMMAND {TARGET} {item.name} BIG_ENDIAN {_quoted(item.doc)}"
    header = (
        ("PACKET_ID", 16, TC_PACKET_ID, True),
        ("SEQUENCE", 16, UNSEGMENTED, False),
        ("LENGTH", 16, 0, False),
        ("PUS_VERSION_ACK", 8, PUS_VERSION_ACK, False),
        ("SERVICE", 8, item.service, True),
        ("SUBTYPE", 8, item.subtype, True),
        ("SOURCE", 16, 0, False),
    )
    match = dict(item.match)
    for name, bits, value, identifies in header:
        yield _parameter_line(name, bits, value, identifies=identifies, doc="")
    for argument in item.arguments:
        if argument.name in match:
            yield _parameter_line(
                argument.name.upper(),
                8 * argument.size_bytes,
                match[argument.name],
                identifies=True,
                doc=argument.doc,
            )
        else:
            yield _argument_line(argument)
            yield from _details(argument)


def _parameter_line(name: str, bits: int, value: int, *, identifies: bool, doc: str) -> str:
    word = "APPEND_ID_PARAMETER" if identifies else "APPEND_PARAMETER"
    return f"  {word} {name} {bits} UINT 0 {(1 << bits) - 1} {value} {_quoted(doc)}"


def _argument_line(item: Field) -> str:
    name, kind, doc = item.name.upper(), _kind(item), _quoted(item.doc)
    bits = 8 * item.size_bytes
    if item.type in (Type.TEXT, Type.BYTES):
        return f'  APPEND_PARAMETER {name} {bits} {kind} "" {doc}'
    if item.type in FLOATS:
        bound = FLOAT_BOUND[item.type]
        low = f"-{bound}" if item.minimum is None else repr(item.minimum)
        high = bound if item.maximum is None else repr(item.maximum)
        default = item.minimum or 0.0
        return f"  APPEND_PARAMETER {name} {bits} {kind} {low} {high} {default!r} {doc}"
    smallest, largest = integer_range(item)
    labels = sorted(item.enumeration.labels) if item.enumeration is not None else [smallest]
    return f"  APPEND_PARAMETER {name} {bits} {kind} {smallest} {largest} {labels[0]} {doc}"


def _details(item: Field) -> Iterator[str]:
    if item.enumeration is not None:
        yield from _states(item.enumeration)
    if item.unit:
        yield f"    UNITS {_quoted(item.unit)} {_quoted(item.unit)}"


def _states(enumeration: Enumeration) -> Iterator[str]:
    for value, label in enumeration.labels.items():
        yield f"    STATE {label.upper()} {value}"


def _kind(item: Field) -> str:
    if item.type is Type.TEXT:
        return "STRING"
    if item.type is Type.BYTES:
        return "BLOCK"
    if item.type in FLOATS:
        return "FLOAT"
    return "INT" if item.type in SIGNED and SIZE_BYTES[item.type] else "UINT"


def _quoted(text: str) -> str:
    return '"' + text.replace('"', "'") + '"'
