"""Types of the dictionary: fields, packets, telecommands, parameters, events."""

from dataclasses import dataclass, field
from enum import IntEnum, StrEnum


class Type(StrEnum):
    """Type of a field on the wire, big-endian."""

    U8 = "u8"
    U16 = "u16"
    U24 = "u24"
    U32 = "u32"
    U64 = "u64"
    I8 = "i8"
    I16 = "i16"
    I32 = "i32"
    I64 = "i64"
    F32 = "f32"
    F64 = "f64"
    TEXT = "text"  # UTF-8 in a fixed size, padded with at least one zero byte
    BYTES = "bytes"  # the rest of the packet; only as the last argument of a telecommand


SIZE_BYTES = {
    Type.U8: 1,
    Type.U16: 2,
    Type.U24: 3,
    Type.U32: 4,
    Type.U64: 8,
    Type.I8: 1,
    Type.I16: 2,
    Type.I32: 4,
    Type.I64: 8,
    Type.F32: 4,
    Type.F64: 8,
}


class Severity(IntEnum):
    """Severity of an event; the value is its subtype in service 5."""

    INFO = 1
    LOW = 2
    MEDIUM = 3
    HIGH = 4


class Concern(IntEnum):
    """Level of attention that a telemetered value needs on the ground."""

    NORMAL = 0
    YELLOW = 1
    RED = 2


class Significance(StrEnum):
    """Importance of a telecommand, in the levels of ISO 14950 that XTCE names."""

    NORMAL = "normal"
    VITAL = "vital"  # something is lost if it is sent at the wrong time
    CRITICAL = "critical"  # the daemon stops or works on other data; confirm before sending


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Inclusive bounds of a telemetered number for ground displays; None: no bound.

    The daemon itself does not use them: it acts on the monitors of service 12.
    """

    red_low: float | None = None
    yellow_low: float | None = None
    yellow_high: float | None = None
    red_high: float | None = None

    def concern(self, value: float) -> Concern:
        """Return the level of attention that a value needs."""
        if _outside(value, self.red_low, self.red_high):
            return Concern.RED
        outside = _outside(value, self.yellow_low, self.yellow_high)
        return Concern.YELLOW if outside else Concern.NORMAL


def _outside(value: float, low: float | None, high: float | None) -> bool:
    return (low is not None and value < low) or (high is not None and value > high)


@dataclass(frozen=True, slots=True, kw_only=True)
class Enumeration:
    """Labels of the values that an integer field may have."""

    name: str
    labels: dict[int, str]

    def value(self, label: str) -> int:
        """Return the number of a label. Raises KeyError."""
        for number, text in self.labels.items():
            if text == label:
                return number
        raise KeyError(label)


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """One flat value of a packet, or one argument of a telecommand.

    `minimum` and `maximum` bound a telecommand's argument; they have no effect on telemetry.
    `limits` (of numbers) and `alarms` (of labels) define which values need attention on the ground.
    """

    name: str
    type: Type
    unit: str = ""
    doc: str = ""
    enumeration: Enumeration | None = None
    size: int = 0  # size of a TEXT [B]; 0 for other types
    minimum: float | None = None
    maximum: float | None = None
    limits: Limits | None = None
    alarms: tuple[tuple[str, Concern], ...] = ()

    @property
    def size_bytes(self) -> int:
        """Return the size on the wire [B]; 0 for BYTES."""
        if self.type is Type.BYTES:
            return 0
        return self.size if self.type is Type.TEXT else SIZE_BYTES[self.type]


@dataclass(frozen=True, slots=True, kw_only=True)
class Packet:
    """One telemetry packet: its fields in the order between headers and CRC.

    `match` holds field values that, besides APID, service and subtype, distinguish this packet from
    others (the housekeeping set, the parameter). A packet with `secondary_header` False (the time
    packet, ECSS-E-ST-70-41C 7.4.2.1) has neither service nor subtype on the wire.
    """

    name: str
    apid: int
    service: int
    subtype: int
    doc: str
    fields: tuple[Field, ...]
    match: tuple[tuple[str, int], ...] = ()
    secondary_header: bool = True

    @property
    def size_bytes(self) -> int:
        """Return the size of all fields [B]."""
        return sum(item.size_bytes for item in self.fields)


@dataclass(frozen=True, slots=True, kw_only=True)
class Telecommand:
    """One telecommand: its arguments in the order between secondary header and CRC.

    `match` holds arguments with a fixed value (the function of service 8). `accepted_in` names
    the mode, one or several, in which it is accepted; empty: any. `verification` lists the subtypes
    of the success reports of service 1 in order; the failure of a stage has the next subtype.
    `timeout_s` bounds the time until the last report. `hazard` is the possible damage by a
    telecommand above NORMAL.
    """

    name: str
    service: int
    subtype: int
    doc: str
    arguments: tuple[Field, ...] = ()
    match: tuple[tuple[str, int], ...] = ()
    accepted_in: tuple[str, ...] = ()
    repeats: bool = False  # whether the first argument counts repetitions of the others
    verification: tuple[int, ...] = (1, 3, 7)
    timeout_s: float = 10.0
    significance: Significance = Significance.NORMAL
    hazard: str = ""

    @property
    def function_id(self) -> int | None:
        """Return the function number of service 8; None for other services."""
        return dict(self.match).get("function_id")


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One on-board parameter of service 20."""

    id: int
    name: str
    type: Type
    default: float
    minimum: float
    maximum: float
    unit: str = ""
    doc: str = ""
    accepted_in: tuple[str, ...] = ()  # the mode in which it may be set; empty: any


@dataclass(frozen=True, slots=True, kw_only=True)
class EventDefinition:
    """One event of service 5."""

    id: int
    code: str
    severity: Severity
    doc: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Dictionary:
    """Definition of every packet, telecommand, parameter and event on the link."""

    packets: tuple[Packet, ...]
    telecommands: tuple[Telecommand, ...]
    parameters: tuple[Parameter, ...]
    events: tuple[EventDefinition, ...]
    errors: dict[int, str] = field(default_factory=dict)

    def packet(self, name: str) -> Packet:
        """Return the packet of a name. Raises KeyError."""
        for packet in self.packets:
            if packet.name == name:
                return packet
        raise KeyError(name)

    def telecommand(self, name: str) -> Telecommand:
        """Return the telecommand of a name. Raises KeyError."""
        for telecommand in self.telecommands:
            if telecommand.name == name:
                return telecommand
        raise KeyError(name)
