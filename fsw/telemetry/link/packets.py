"""Packs and unpacks packets by the dictionary (CCSDS 133.0-B, headers of ECSS-E-ST-70-41C).

Time is mission elapsed time, the daemon's own clock, as CUC 4+3 with P-field (CCSDS 301.0-B).
"""

import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from spacepackets.ccsds.spacepacket import PacketType, SpacePacket, SpacePacketHeader
from spacepackets.ecss.tc import PusTc
from spacepackets.ecss.tm import PusTm

from fsw.telemetry.dictionary import DICTIONARY, Field, Packet, Telecommand, Type
from fsw.telemetry.dictionary.codes import APID_ESTIMATOR, APID_FILES

P_FIELD = 0x2F
CUC_BYTES = 8
FRACTIONS_PER_S = 1 << 24
HEADER_BYTES = 6
TM_HEADER_BYTES = HEADER_BYTES + 7 + CUC_BYTES
TC_HEADER_BYTES = HEADER_BYTES + 5
CRC_BYTES = 2
COUNT_14 = 1 << 14
COUNT_16 = 1 << 16
ACK_ALL = 0b1111
ACK_COMPLETION = 0b1001  # acceptance and completion, whichever bit is numbered first
_FORMAT = {
    Type.U8: "B",
    Type.U16: "H",
    Type.U24: "3s",
    Type.U32: "I",
    Type.U64: "Q",
    Type.I8: "b",
    Type.I16: "h",
    Type.I32: "i",
    Type.I64: "q",
    Type.F32: "f",
    Type.F64: "d",
}
_RANGE = {
    Type.U8: (0, 0xFF),
    Type.U16: (0, 0xFFFF),
    Type.U24: (0, 0xFFFFFF),
    Type.U32: (0, 0xFFFFFFFF),
    Type.U64: (0, (1 << 64) - 1),
    Type.I8: (-(1 << 7), (1 << 7) - 1),
    Type.I16: (-(1 << 15), (1 << 15) - 1),
    Type.I32: (-(1 << 31), (1 << 31) - 1),
    Type.I64: (-(1 << 63), (1 << 63) - 1),
}
_LARGEST = {Type.F32: 3.4028234663852886e38, Type.F64: 1.7976931348623157e308}

Value = int | float | str


def cuc(t_ns: int) -> bytes:
    """Return a time as CUC 4+3 with P-field (8 bytes), rounded down to 2^-24 s, modulo 2^32 s."""
    coarse, rest_ns = divmod(t_ns, 1_000_000_000)
    fine = rest_ns * FRACTIONS_PER_S // 1_000_000_000
    return struct.pack(">BIBH", P_FIELD, coarse & 0xFFFFFFFF, fine >> 16, fine & 0xFFFF)


def from_cuc(data: bytes) -> int:
    """Return the time in 8 bytes of CUC [ns], rounded up. Raises ValueError for another P-field."""
    p_field, coarse, high, low = struct.unpack(">BIBH", data)
    if p_field != P_FIELD:
        raise ValueError(f"P-field 0x{p_field:02x}; must be 0x{P_FIELD:02x}")
    fine = int(high) << 16 | int(low)
    return int(coarse) * 1_000_000_000 + -(-fine * 1_000_000_000 // FRACTIONS_PER_S)


class Layout:
    """Packs and unpacks a sequence of fields of fixed size."""

    def __init__(self, fields: Sequence[Field]) -> None:
        self.fields = tuple(fields)
        parts = [f"{f.size}s" if f.type is Type.TEXT else _FORMAT[f.type] for f in self.fields]
        self._struct = struct.Struct(">" + "".join(parts))
        self._encoders = [_encoder(f) for f in self.fields]
        self.size_bytes = self._struct.size

    def pack(self, values: Iterable[object]) -> bytes:
        """Return the values as bytes; a value outside a field's range becomes the nearest limit.

        NaN becomes 0, because separate fields report validity.
        """
        pairs = zip(self._encoders, values, strict=True)
        return self._struct.pack(*[encode(value) for encode, value in pairs])

    def unpack(self, data: bytes) -> dict[str, Value]:
        """Return the values by field name. Raises struct.error if the length is wrong."""
        raw = self._struct.unpack(data)
        return {f.name: _decode(f, item) for f, item in zip(self.fields, raw, strict=True)}


def _encoder(field: Field) -> Callable[[Any], int | float | bytes]:
    """Return a function that converts a value to the nearest one that the field can hold."""
    kind = field.type
    if kind is Type.TEXT:
        return lambda value: _text_bytes(str(value), field.size - 1)  # readers look for a zero
    if kind in _LARGEST:
        return partial(_real, _LARGEST[kind])
    low, high = _RANGE[kind]
    whole = partial(_whole, low, high)
    if field.enumeration is not None:
        numbers = {label: number for number, label in field.enumeration.labels.items()}
        return lambda value: whole(numbers[value] if isinstance(value, str) else value)
    if kind is Type.U24:
        return lambda value: whole(value).to_bytes(3, "big")
    return whole


def _real(largest: float, value: float) -> float:
    number = float(value)
    if -largest <= number <= largest:
        return number
    return 0.0 if math.isnan(number) else math.copysign(largest, number)


def _whole(low: int, high: int, value: float) -> int:
    if value != value:  # noqa: PLR0124  NaN of any type
        return 0
    return int(min(max(value, low), high))


def _text_bytes(text: str, size: int) -> bytes:
    """Return a text as UTF-8 of at most `size` bytes, cut between two characters."""
    return text.encode(errors="backslashreplace")[:size].decode(errors="ignore").encode()


def _decode(field: Field, raw: Any) -> Value:  # noqa: ANN401
    if field.type is Type.TEXT:
        return str(raw.rstrip(b"\0").decode(errors="replace"))
    if field.type is Type.U24:
        return int.from_bytes(raw, "big")
    value: Value = raw
    return value


class Packetizer:
    """Makes telemetry packets, with counters per application process and per message type."""

    def __init__(self) -> None:
        self._layouts = {p.name: (p, Layout(p.fields)) for p in DICTIONARY.packets}
        self._sequences: dict[int, int] = {}
        self._messages: dict[tuple[int, int], int] = {}

    def make(self, name: str, t_ns: int, values: Mapping[str, object]) -> bytes:
        """Return one packet of the dictionary. Raises KeyError if a value is missing."""
        packet, layout = self._layouts[name]
        fixed = dict(packet.match)
        data = layout.pack(
            fixed[f.name] if f.name in fixed else values[f.name] for f in layout.fields
        )
        return self.wrap(packet, t_ns, data)

    def wrap(self, packet: Packet, t_ns: int, data: bytes) -> bytes:
        """Return one packet; `data` holds its packed fields."""
        sequence = self._next(packet.apid)
        if not packet.secondary_header:
            return _plain(packet.apid, sequence, data, PacketType.TM, crc=True)
        message = (packet.service, packet.subtype)
        counter = self._messages.get(message, 0)
        self._messages[message] = (counter + 1) % COUNT_16
        tm = PusTm(
            apid=packet.apid,
            service=packet.service,
            message_subtype=packet.subtype,
            timestamp=cuc(t_ns),
            seq_count=sequence,
            message_counter=counter,
            source_data=data,
        )
        return bytes(tm.pack())

    def file_packet(self, pdu: bytes) -> bytes:
        """Return a file-delivery unit in a space packet without secondary header or packet CRC."""
        return _plain(APID_FILES, self._next(APID_FILES), pdu, PacketType.TM, crc=False)

    def _next(self, apid: int) -> int:
        sequence = self._sequences.get(apid, 0)
        self._sequences[apid] = (sequence + 1) % COUNT_14
        return sequence


def uplink_file_packet(pdu: bytes, sequence: int) -> bytes:
    """Return a file-delivery unit in a space packet for the uplink."""
    return _plain(APID_FILES, sequence, pdu, PacketType.TC, crc=False)


def _plain(apid: int, sequence: int, data: bytes, kind: PacketType, *, crc: bool) -> bytes:
    from fastcrc import crc16

    length = len(data) + (CRC_BYTES if crc else 0)
    header = SpacePacketHeader(
        packet_type=kind, apid=apid, seq_count=sequence, data_len=length - 1, sec_header_flag=False
    )
    packet = bytes(SpacePacket(header, b"", data).pack())
    return packet + crc16.ibm_3740(packet).to_bytes(2, "big") if crc else packet


@dataclass(frozen=True, slots=True, kw_only=True)
class Telemetry:
    """A decoded telemetry packet."""

    packet: Packet
    sequence: int
    message_counter: int
    t_ns: int
    values: dict[str, Value]


class Decoder:
    """Decodes telemetry packets by the dictionary."""

    def __init__(self) -> None:
        self._by_key: dict[tuple[int, int, int], list[tuple[Packet, Layout]]] = {}
        for packet in DICTIONARY.packets:
            key = (packet.apid, packet.service, packet.subtype)
            self._by_key.setdefault(key, []).append((packet, Layout(packet.fields)))

    def decode(self, raw: bytes) -> Telemetry:
        """Return a decoded packet. Raises ValueError if the dictionary does not define it."""
        header = SpacePacketHeader.unpack(raw)
        if not header.sec_header_flag:
            (entry,) = self._by_key.get((header.apid, 9, 2), [None])
            if entry is None:
                raise ValueError(f"APID {header.apid} without secondary header")
            values = entry[1].unpack(raw[HEADER_BYTES:-CRC_BYTES])
            t_ns = from_cuc(raw[HEADER_BYTES + 1 : HEADER_BYTES + 1 + CUC_BYTES])
            return Telemetry(
                packet=entry[0],
                sequence=header.seq_count,
                message_counter=0,
                t_ns=t_ns,
                values=values,
            )
        tm = PusTm.unpack(raw, CUC_BYTES)
        for packet, layout in self._by_key.get((tm.apid, tm.service, tm.message_subtype), []):
            if len(tm.source_data) != layout.size_bytes:
                continue
            values = layout.unpack(bytes(tm.source_data))
            if all(values[name] == number for name, number in packet.match):
                return Telemetry(
                    packet=packet,
                    sequence=tm.seq_count,
                    message_counter=tm.pus_tm_sec_header.message_counter,
                    t_ns=from_cuc(bytes(tm.timestamp)),
                    values=values,
                )
        raise ValueError(f"no packet {tm.apid}/{tm.service},{tm.message_subtype} is like this")


def telecommand_packet(
    telecommand: Telecommand,
    values: Mapping[str, object],
    sequence: int,
    *,
    ack: int = ACK_ALL,
    apid: int = APID_ESTIMATOR,
    source: int = 0,
) -> bytes:
    """Return a telecommand packet as the ground sends it. Raises KeyError for a missing argument.

    `values` holds a BYTES argument as bytes, and of a repeated group exactly one element.
    """
    fixed = dict(telecommand.match)
    if telecommand.repeats and telecommand.arguments[0].name not in values:
        fixed[telecommand.arguments[0].name] = 1
    parts = []
    for field in telecommand.arguments:
        value = fixed.get(field.name, values.get(field.name))
        if value is None:
            raise KeyError(field.name)
        if field.type is Type.BYTES:
            parts.append(value if isinstance(value, bytes) else b"")
        else:
            parts.append(Layout([field]).pack([value]))
    tc = PusTc(
        service=telecommand.service,
        message_subtype=telecommand.subtype,
        apid=apid,
        app_data=b"".join(parts),
        seq_count=sequence % COUNT_14,
        source_id=source,
        ack_flags=ack,
    )
    return bytes(tc.pack())


def parameters_data(changes: Mapping[int, float]) -> bytes:
    """Return the arguments of SET_PARAMETERS: the count (u8), then id (u16) and value of each."""
    by_id = {item.id: item for item in DICTIONARY.parameters}
    parts = [bytes((len(changes),))]
    for number, value in changes.items():
        item = by_id[number]
        field = Field(name=item.name, type=item.type)
        parts.append(struct.pack(">H", number) + Layout([field]).pack([value]))
    return b"".join(parts)
