"""Telecommands of the dictionary as XTCE meta-commands.

Each command has the header of the base command, then its arguments. The sender fills in length,
sequence count and CRC (in Yamcs the PUS command post-processor with a CRC of 16 bits). Level and
warning are significance and hazard in the dictionary; verifiers follow the reports of service 1.
"""

import struct

from yamcs.pymdb.commands import (
    Argument,
    ArgumentEntry,
    BinaryArgument,
    Command,
    CommandEntry,
    CommandLevel,
    EnumeratedArgument,
    FixedValueEntry,
    FloatArgument,
    IntegerArgument,
    StringArgument,
)
from yamcs.pymdb.encodings import BinaryEncoding
from yamcs.pymdb.systems import System

from fsw.telemetry.dictionary import Dictionary, Field, Significance, Type
from fsw.telemetry.dictionary.codes import APID_ESTIMATOR
from fsw.telemetry.dictionary.types import SIZE_BYTES
from offline.exports.single import SingleCommand, single_commands
from offline.exports.verifiers import add_verifiers
from offline.exports.xtce import FLOATS, SIGNED, encoding

BASE = "pus_telecommand"
TC_PACKET_ID = 0x1800 | APID_ESTIMATOR  # type telecommand, secondary header
UNSEGMENTED = 0xC000
PUS_VERSION_ACK = 0x2F  # PUS-C; acceptance, start, progress and completion are reported
LEVELS = {
    Significance.NORMAL: CommandLevel.NORMAL,
    Significance.VITAL: CommandLevel.VITAL,
    Significance.CRITICAL: CommandLevel.CRITICAL,
}


def add_commands(root: System, dictionary: Dictionary) -> None:
    """Add all telecommands of the dictionary to an XTCE system."""
    base = Command(root, BASE, abstract=True, entries=[_fixed("packet_id", TC_PACKET_ID, 2)])
    base.entries = [
        *base.entries,
        _fixed("sequence", UNSEGMENTED, 2),
        _fixed("length", 0, 2),
        _fixed("pus_version_ack", PUS_VERSION_ACK, 1),
    ]
    for item in single_commands(dictionary):
        _add(root, base, item)


def _add(root: System, base: Command, item: SingleCommand) -> None:
    telecommand = item.telecommand
    entries: list[CommandEntry] = [
        _fixed("service", telecommand.service, 1),
        _fixed("subtype", telecommand.subtype, 1),
        _fixed("source", 0, 2),
    ]
    free: list[Argument] = []  # type: ignore[type-arg]
    for part in item.arguments:
        if part.name in item.fixed:
            entries.append(_fixed(part.name, item.fixed[part.name], part.size_bytes))
        else:
            free.append(argument(part))
            entries.append(ArgumentEntry(free[-1]))
    command = Command(
        root,
        item.name,
        base=base,
        short_description=telecommand.doc,
        arguments=free,
        entries=entries,
        level=LEVELS[telecommand.significance],
        warning_message=telecommand.hazard or None,
    )
    add_verifiers(command, telecommand)


def _fixed(name: str, value: int, size: int) -> FixedValueEntry:
    return FixedValueEntry(value.to_bytes(size, "big"), name=name, bits=8 * size)


def argument(item: Field) -> Argument:  # type: ignore[type-arg]
    """Return one field as an XTCE argument with its range."""
    doc, units = item.doc or None, item.unit or None
    if item.type is Type.BYTES:
        return BinaryArgument(item.name, short_description=doc, encoding=BinaryEncoding())
    coding = encoding(item)
    if item.enumeration is not None:
        choices = list(item.enumeration.labels.items())
        return EnumeratedArgument(item.name, choices, short_description=doc, encoding=coding)
    if item.type is Type.TEXT:
        return StringArgument(
            item.name, max_length=item.size, short_description=doc, encoding=coding
        )
    if item.type in FLOATS:
        return FloatArgument(
            item.name,
            bits=32 if item.type is Type.F32 else 64,
            minimum=_as_sent(item, item.minimum),
            maximum=_as_sent(item, item.maximum),
            short_description=doc,
            units=units,
            encoding=coding,
        )
    low, high = integer_range(item)
    return IntegerArgument(
        item.name,
        signed=item.type in SIGNED,
        bits=max(32, 8 * item.size_bytes),
        minimum=low,
        maximum=high,
        short_description=doc,
        units=units,
        encoding=coding,
    )


def integer_range(item: Field) -> tuple[int, int]:
    """Return the lowest and highest value of an integer field: its bounds, or its type's."""
    bits = 8 * SIZE_BYTES[item.type]
    low, high = (
        (-(1 << bits - 1), (1 << bits - 1) - 1) if item.type in SIGNED else (0, (1 << bits) - 1)
    )
    return (
        low if item.minimum is None else int(item.minimum),
        high if item.maximum is None else int(item.maximum),
    )


def _as_sent(item: Field, bound: float | None) -> float | None:
    """Return a bound rounded to the type of its argument; None without a bound."""
    if bound is None or item.type is Type.F64:
        return bound
    return float(struct.unpack(">f", struct.pack(">f", bound))[0])
