"""The dictionary as COSMOS configuration: one target with `cmd.txt` and `tlm.txt`, and a plugin.

The items before the fields are the packet's headers; identifying items have fixed values.
The sequence count is a parameter to set, for COSMOS does not count; verification reports name it.
"""

from collections.abc import Iterator

from fsw.telemetry.dictionary import Concern, Dictionary, Field, Packet, Significance, Type
from fsw.telemetry.dictionary.types import SIZE_BYTES
from offline.exports.single import SingleCommand, single_commands
from offline.exports.xtce import FLOATS, PRIMARY, SECONDARY, SIGNED
from offline.exports.xtce_commands import (
    PUS_VERSION_ACK,
    TC_PACKET_ID,
    UNSEGMENTED,
    integer_range,
)

TARGET = "INERTIA"
FLOAT_BOUND = {Type.F32: "3.4e38", Type.F64: "1.7e308"}
CRC = "CRC16"
TC_HEADER_BYTES, CRC_BYTES = 11, 2
COLOURS = {Concern.NORMAL: "GREEN", Concern.YELLOW: "YELLOW", Concern.RED: "RED"}
PLUGIN = f"""# COSMOS plugin: target and interface. Give host and port of the daemon's link when installing it.
VARIABLE inertia_host 127.0.0.1
VARIABLE inertia_port 10025

TARGET {TARGET} {TARGET}
INTERFACE {TARGET}_INT openc3/interfaces/tcpip_client_interface.py <%= inertia_host %> <%= inertia_port %> <%= inertia_port %> 10.0 nil
  MAP_TARGET {TARGET}
  # A protocol named later acts earlier on a command: first its length, then its CRC.
  PROTOCOL WRITE openc3/interfaces/protocols/crc_protocol.py {CRC} FALSE ERROR -16 16
  PROTOCOL READ_WRITE openc3/interfaces/protocols/length_protocol.py 32 16 7 1 BIG_ENDIAN 0 nil nil TRUE
"""  # noqa: E501


def telemetry(dictionary: Dictionary) -> str:
    """Return the telemetry definition, the text of `tlm.txt`."""
    return "\n\n".join("\n".join(_packet(packet)) for packet in dictionary.packets) + "\n"


def telecommands(dictionary: Dictionary) -> str:
    """Return the command definition, the text of `cmd.txt`."""
    return "\n\n".join("\n".join(_command(item)) for item in single_commands(dictionary)) + "\n"


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
        yield from _states(item)
        yield from _units(item)
        yield from _limits(item)
    yield f'  APPEND_ITEM {CRC} 16 UINT "CCITT-FALSE over all before"'


def _command(command: SingleCommand) -> Iterator[str]:
    item = command.telecommand
    yield f"COMMAND {TARGET} {command.name.upper()} BIG_ENDIAN {_quoted(item.doc)}"
    if item.significance is not Significance.NORMAL:
        yield f"  HAZARDOUS {_quoted(item.hazard)}"
    reports = " ".join(f"1,{subtype}" for subtype in item.verification)
    yield f"  META VERIFICATION {_quoted(reports)} {item.timeout_s:g}"
    yield f"  META SIGNIFICANCE {item.significance}"
    size = TC_HEADER_BYTES + sum(part.size_bytes for part in command.arguments) + CRC_BYTES
    header = (
        ("HEADER_PACKET_ID", 16, TC_PACKET_ID, True),
        ("HEADER_SEQUENCE", 16, UNSEGMENTED, False),
        ("HEADER_LENGTH", 16, size - 7, False),
        ("HEADER_PUS_VERSION_ACK", 8, PUS_VERSION_ACK, False),
        ("HEADER_SERVICE", 8, item.service, True),
        ("HEADER_SUBTYPE", 8, item.subtype, True),
        ("HEADER_SOURCE", 16, 0, False),
    )
    for name, bits, value, identifies in header:
        yield _parameter_line(name, bits, value, identifies=identifies, doc="")
    for part in command.arguments:
        if part.name in command.fixed:
            yield _parameter_line(
                part.name.upper(),
                8 * part.size_bytes,
                command.fixed[part.name],
                identifies=True,
                doc=part.doc,
            )
        else:
            yield _argument_line(part)
            yield from _states(part)
            yield from _units(part)
    bits = 8 * CRC_BYTES
    open_ended = bool(command.arguments) and command.arguments[-1].type is Type.BYTES
    place = f"PARAMETER {CRC} -{bits}" if open_ended else f"APPEND_PARAMETER {CRC}"
    yield f'  {place} {bits} UINT 0 {(1 << bits) - 1} 0 "filled in by its protocol"'


def _parameter_line(name: str, bits: int, value: int, *, identifies: bool, doc: str) -> str:
    word = "APPEND_ID_PARAMETER" if identifies else "APPEND_PARAMETER"
    return f"  {word} {name} {bits} UINT 0 {(1 << bits) - 1} {value} {_quoted(doc)}"


def _argument_line(item: Field) -> str:
    name, kind, doc = item.name.upper(), _kind(item), _quoted(item.doc)
    bits = 8 * item.size_bytes
    if item.type is Type.BYTES:  # a negative size: all bytes up to the CRC
        return f'  APPEND_PARAMETER {name} -{8 * CRC_BYTES} {kind} "" {doc}'
    if item.type is Type.TEXT:
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


def _states(item: Field) -> Iterator[str]:
    """Yield the labels of a field, with colours if some of the labels need attention."""
    labels = item.enumeration.labels if item.enumeration is not None else {}
    concerns = dict(item.alarms)
    for value, label in labels.items():
        colour = ""
        if item.alarms:
            colour = f" {COLOURS[concerns.get(label, Concern.NORMAL)]}"
        yield f"    STATE {label.upper()} {value}{colour}"


def _units(item: Field) -> Iterator[str]:
    if item.unit:
        yield f"    UNITS {_quoted(item.unit)} {_quoted(item.unit)}"


def _limits(item: Field) -> Iterator[str]:
    """Yield the four limits that COSMOS needs; a missing red one is the end of the type's range.

    COSMOS counts a value at a limit as outside, the dictionary as inside: integers move out by 1.
    """
    if item.limits is None:
        return
    step = 0 if item.type in FLOATS else 1
    if item.type in FLOATS:
        least, most = float(f"-{FLOAT_BOUND[item.type]}"), float(FLOAT_BOUND[item.type])
    else:
        least, most = integer_range(item)
    given = item.limits
    red_low = least if given.red_low is None else given.red_low
    red_high = most if given.red_high is None else given.red_high
    values = (
        red_low - step,
        (red_low if given.yellow_low is None else given.yellow_low) - step,
        (red_high if given.yellow_high is None else given.yellow_high) + step,
        red_high + step,
    )
    yield "    LIMITS DEFAULT 1 ENABLED " + " ".join(f"{value:.17g}" for value in values)


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
