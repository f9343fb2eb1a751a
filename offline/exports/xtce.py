"""The dictionary as XTCE, in a flat form that any ground system can read.

There is one SpaceSystem, without array or aggregate types. Parameters are named `packet_field`,
because an XTCE parameter has one place and one type. Enumerated values are the numbers on the wire.
"""

from dataclasses import replace

from yamcs.pymdb.alarms import AlarmLevel, EnumerationAlarm, ThresholdAlarm
from yamcs.pymdb.containers import Container, ParameterEntry
from yamcs.pymdb.encodings import (
    Charset,
    Encoding,
    FloatEncoding,
    IntegerEncoding,
    IntegerEncodingScheme,
    StringEncoding,
)
from yamcs.pymdb.expressions import AndExpression, EqExpression
from yamcs.pymdb.parameters import (
    EnumeratedParameter,
    FloatParameter,
    IntegerParameter,
    Parameter,
    StringParameter,
)
from yamcs.pymdb.systems import System

from fsw.telemetry.dictionary import Concern, Dictionary, Field, Limits, Packet, Type
from fsw.telemetry.dictionary.codes import APID_FILES
from fsw.telemetry.dictionary.types import SIZE_BYTES

SYSTEM = "inertia"
ROOT = "CCSDSPacket"  # name of the root container that readers look for
FLOATS = (Type.F32, Type.F64)
SIGNED = (Type.I8, Type.I16, Type.I32, Type.I64)
PRIMARY = (  # CCSDS 133.0-B 4.1.3
    ("version", 3),
    ("type", 1),
    ("secondary_header", 1),
    ("apid", 11),
    ("sequence_flags", 2),
    ("sequence_count", 14),
    ("length", 16),
)
SECONDARY = (  # ECSS-E-ST-70-41C 7.4.3, CUC time of CCSDS 301.0-B with its P-field
    ("pus_version", 4),
    ("time_status", 4),
    ("service", 8),
    ("subtype", 8),
    ("message_counter", 16),
    ("destination", 16),
    ("time_p_field", 8),
    ("time_coarse_s", 32),
    ("time_fine", 24),
)
CRC_BITS = 16
ALARM_LEVELS = {Concern.YELLOW: AlarmLevel.WARNING, Concern.RED: AlarmLevel.CRITICAL}


def system(dictionary: Dictionary) -> System:
    """Return the telemetry packets of the dictionary as an XTCE system."""
    root = System(SYSTEM, short_description="Inertia daemon")
    primary = _header(root, PRIMARY)
    base = Container(root, ROOT, list(primary.values()), abstract=True)
    secondary = _header(root, SECONDARY)
    pus = Container(
        root,
        "pus_packet",
        list(secondary.values()),
        base=base,
        abstract=True,
        condition=_all(primary, {"type": 0, "secondary_header": 1}),
    )
    crc = ParameterEntry(_unsigned(root, "crc16", CRC_BITS, "CCITT-FALSE over all before"))
    parents: dict[tuple[int, int, str], tuple[Container, ParameterEntry]] = {}
    for packet in dictionary.packets:
        if not packet.secondary_header:
            condition = _all(primary, {"secondary_header": 0, "apid": packet.apid})
            _container(root, packet, packet.fields, base, condition, crc)
        elif packet.match:
            ((key, value),) = packet.match
            kind = (packet.service, packet.subtype, key)
            if kind not in parents:
                parents[kind] = _parent(root, packet, pus, secondary)
            parent, selector = parents[kind]
            condition = _all({key: selector}, {key: value, "apid": packet.apid}, primary)
            shared = 1 + [item.name for item in packet.fields].index(key)
            _container(root, packet, packet.fields[shared:], parent, condition, crc)
        else:
            values = {"apid": packet.apid, "service": packet.service, "subtype": packet.subtype}
            condition = _all(primary | secondary, values)
            _container(root, packet, packet.fields, pus, condition, crc)
    _file_packet(root, base, primary)
    return root


def _header(root: System, layout: tuple[tuple[str, int], ...]) -> dict[str, ParameterEntry]:
    return {
        name: ParameterEntry(_unsigned(root, f"header_{name}", bits, "")) for name, bits in layout
    }


def _parent(
    root: System, packet: Packet, pus: Container, secondary: dict[str, ParameterEntry]
) -> tuple[Container, ParameterEntry]:
    """Return the container of one service and subtype, and the entry that selects its packets.

    The entry is a plain number, because readers differ in comparisons with enumerated values.
    """
    ((key, _value),) = packet.match
    name = f"service_{packet.service}_{packet.subtype}"
    shared: dict[str, ParameterEntry] = {}
    for item in packet.fields:
        plain = replace(item, enumeration=None)
        shared[item.name] = ParameterEntry(parameter(root, f"{name}_{item.name}", plain))
        if item.name == key:
            break
    condition = _all(secondary, {"service": packet.service, "subtype": packet.subtype})
    entries = list(shared.values())
    parent = Container(root, name, list(entries), base=pus, abstract=True, condition=condition)
    return parent, shared[key]


def _container(
    root: System,
    packet: Packet,
    fields: tuple[Field, ...],
    base: Container,
    condition: AndExpression,
    crc: ParameterEntry,
) -> None:
    entries = [
        ParameterEntry(parameter(root, f"{packet.name}_{item.name}", item)) for item in fields
    ]
    entries.append(ParameterEntry(crc.parameter))
    Container(
        root,
        packet.name,
        list(entries),
        base=base,
        condition=condition,
        short_description=packet.doc,
    )


def _all(
    entries: dict[str, ParameterEntry],
    values: dict[str, int],
    more: dict[str, ParameterEntry] | None = None,
) -> AndExpression:
    known = {**(more or {}), **entries}
    return AndExpression(
        *(
            EqExpression(known[name].parameter, value, calibrated=False)
            for name, value in values.items()
        )
    )


def parameter(root: System, name: str, item: Field) -> Parameter:  # type: ignore[type-arg]
    """Return one field as an XTCE parameter named `name`."""
    doc, units, coding = item.doc or None, item.unit or None, encoding(item)
    if item.enumeration is not None:
        choices = list(item.enumeration.labels.items())
        return EnumeratedParameter(
            root, name, choices, short_description=doc, encoding=coding, alarm=_label_alarm(item)
        )
    if item.type is Type.TEXT:
        return StringParameter(root, name, short_description=doc, encoding=coding)
    if item.type in FLOATS:
        return FloatParameter(
            root,
            name,
            bits=32 if item.type is Type.F32 else 64,
            short_description=doc,
            units=units,
            encoding=coding,
            alarm=_alarm(item.limits),
        )
    return IntegerParameter(
        root,
        name,
        signed=item.type in SIGNED,
        bits=max(32, 8 * item.size_bytes),
        short_description=doc,
        units=units,
        encoding=coding,
        alarm=_alarm(item.limits),
    )


def _alarm(limits: Limits | None) -> ThresholdAlarm | None:
    """Return limits as an XTCE alarm: yellow is the level warning, red is critical."""
    if limits is None:
        return None
    return ThresholdAlarm(
        warning_low=limits.yellow_low,
        warning_low_exclusive=True,
        warning_high=limits.yellow_high,
        warning_high_exclusive=True,
        critical_low=limits.red_low,
        critical_low_exclusive=True,
        critical_high=limits.red_high,
        critical_high_exclusive=True,
    )


def _label_alarm(item: Field) -> EnumerationAlarm | None:
    if not item.alarms:
        return None
    return EnumerationAlarm({label: ALARM_LEVELS[concern] for label, concern in item.alarms})


def encoding(item: Field) -> Encoding:
    """Return the XTCE encoding of a field on the wire."""
    if item.type is Type.TEXT:
        return StringEncoding(bits=8 * item.size, charset=Charset.UTF_8, termination=b"\0")
    bits = 8 * SIZE_BYTES[item.type]
    if item.type in FLOATS:
        return FloatEncoding(bits=bits)
    signed = item.type in SIGNED
    scheme = IntegerEncodingScheme.TWOS_COMPLEMENT if signed else IntegerEncodingScheme.UNSIGNED
    return IntegerEncoding(bits=bits, scheme=scheme)


def _unsigned(root: System, name: str, bits: int, doc: str) -> IntegerParameter:
    coding = IntegerEncoding(bits=bits)
    return IntegerParameter(
        root, name, signed=False, bits=32, encoding=coding, short_description=doc or None
    )


def _file_packet(root: System, base: Container, primary: dict[str, ParameterEntry]) -> None:
    """Add the packet that contains a CFDP PDU; CCSDS 727.0-B defines the PDU's format."""
    Container(
        root,
        "file_pdu",
        base=base,
        condition=_all(primary, {"secondary_header": 0, "apid": APID_FILES}),
        short_description="One CFDP PDU, CCSDS 727.0-B",
    )
