"""Telecommands of the dictionary as XTCE meta-commands.

Each is the base command's header, then its arguments. The length, the sequence count and the CRC
are the sender's (Yamcs: its CCSDS command post-processor). Commands with a repeated group are given
for one element: XTCE has no form for it that readers agree on.
"""

from __future__ import annotations

import struct

from yamcs.pymdb.commands import (
    Argument,
    ArgumentEntry,
    BinaryArgument,
    Command,
    EnumeratedArgument,
    FixedValueEntry,
    FloatArgument,
    IntegerArgument,
    StringArgument,
)
from yamcs.pymdb.encodings import BinaryEncoding
from yamcs.pymdb.systems import System

from fsw.telemetry.dictionary import Dictionary, Field, Parameter, Telecommand, Type
from fsw.telemetry.dictionary.codes import APID_ESTIMATOR
from fsw.telemetry.dictionary.types import SIZE_BYTES
from fsw.telemetry.export.xtce import FLOATS, SIGNED, encoding

BASE = "pus_telecommand"
TC_PACKET_ID = 0x1800 | APID_ESTIMATOR  # type telecommand, secondary header
UNSEGMENTED = 0xC000
PUS_VERSION_ACK = 0x29  # PUS-C, acceptance and completion are reported
SET_PARAMETERS, REPORT_PARAMETERS = "SET_PARAMETERS", "REPORT_PARAMETERS"


def add_commands(root: System, dictionary: Dictionary) -> None:
    """Add every telecommand to a system."""
    base = Command(root, BASE, abstract=True, entries=[_fixed("packet_id", TC_PACKET_ID, 2)])
    base.entries = [
        *base.entries,
        _fixed("sequence", UNSEGMENTED, 2),
        _fixed("length", 0, 2),
        _fixed("pus_version_ack", PUS_VERSION_ACK, 1),
    ]
    for telecommand in dictionary.telecommands:
        if telecommand.name == SET_PARAMETERS:
            for parameter in dictionary.parameters:
                _add(root, base, telecommand, *_setting(telecommand, parameter))
        elif telecommand.repeats:
            count, *arguments = telecommand.arguments
            _add(root, base, telecommand, telecommand.name, tuple(arguments), {count.name: 1})
        else:
            _add(root, base, telecommand, telecommand.name, telecommand.arguments, {})


def _setting(
    telecommand: Telecommand, item: Parameter
) -> tuple[str, tuple[Field, ...], dict[str, int]]:
    """Return the command that sets one parameter in its own type."""
    count, number, _value = telecommand.arguments
    value = Field(
        name="value",
        type=item.type,
        unit=item.unit,
        doc=item.doc,
        minimum=item.minimum,
        maximum=item.maximum,
    )
    return f"SET_{item.name}", (value,), {count.name: 1, number.name: item.id}


def _add(
    root: System,
    base: Command,
    telecommand: Telecommand,
    name: str,
    arguments: tuple[Field, ...],
    first: dict[str, int],
) -> None:
    """Add one command; `first` are fixed values that go before its arguments."""
    sizes = {item.name: item.size_bytes for item in telecommand.arguments}
    fixed = first | dict(telecommand.match)
    entries = [
        _fixed("service", telecommand.service, 1),
        _fixed("subtype", telecommand.subtype, 1),
        _fixed("source", 0, 2),
        *(_fixed(key, value, sizes[key]) for key, value in fixed.items()),
    ]
    free = [argument(item) for item in arguments if item.name not in fixed]
    Command(
        root,
        name,
        base=base,
        short_description=telecommand.doc,
        arguments=free,
        entries=[*entries, *(ArgumentEntry(item) for item in free)],
    )


def _fixed(name: str, value: int, size: int) -> FixedValueEntry:
    return FixedValueEntry(value.to_bytes(size, "big"), name=name, bits=8 * size)


def argument(item: Field) -> Argument:  # type: ignore[type-arg]
    """Return one argument with its range."""
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
    """Return the bounds of an integer: its own, or those of its type."""
    bits = 8 * SIZE_BYTES[item.type]
    low, high = (
        (-(1 << bits - 1), (1 << bits - 1) - 1) if item.type in SIGNED else (0, (1 << bits) - 1)
    )
    return (
        low if item.minimum is None else int(item.minimum),
        high if item.maximum is None else int(item.maximum),
    )


def _as_sent(item: Field, bound: float | None) -> float | None:
    """Return a bound as the argument's own type can hold it."""
    if bound is None or item.type is Type.F64:
        return bound
    return float(struct.unpack(">f", struct.pack(">f", bound))[0])
