"""Checks the bytes of one telecommand; gives a request, or the error that rejects the bytes."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field, replace

from spacepackets.ccsds.spacepacket import SequenceFlags
from spacepackets.ecss.tc import InvalidTcCrc16Error, PusTc
from spacepackets.exceptions import BytesTooShortError

from fsw.errors import cut, unforeseen
from fsw.telemetry.dictionary import DICTIONARY, Field, Parameter, Telecommand, Type
from fsw.telemetry.dictionary.codes import APID_ESTIMATOR, Error
from fsw.telemetry.dictionary.commands import MAX_REPEATS
from fsw.telemetry.link.packets import CRC_BYTES, TC_HEADER_BYTES, Layout, Value

ACK_ACCEPTANCE, ACK_START, ACK_PROGRESS, ACK_COMPLETION = 0b0001, 0b0010, 0b0100, 0b1000
PARAMETERS = 20  # the service whose repeated group has values of different types


class TcError(Exception):
    """A telecommand was rejected or failed; `argument` counts from 1, 0 names no argument."""

    def __init__(self, error: Error, argument: int = 0, value: float = 0.0, text: str = "") -> None:
        super().__init__(cut(f"{error.name}{f': {text}' if text else ''}"))
        self.error, self.argument, self.value = error, argument, value

    @classmethod
    def of(cls, error: Exception) -> TcError:
        """Return the TcError for an error of a telecommand. Raises MemoryError unchanged.

        An unforeseen error becomes FAILED, so that no telecommand ends the service.
        """
        if isinstance(error, MemoryError):
            raise error
        return error if isinstance(error, cls) else cls(Error.FAILED, text=unforeseen(error))


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestId:
    """Identity of a telecommand in verification reports: its first four bytes."""

    packet_id: int
    sequence: int

    @classmethod
    def of(cls, packet: bytes) -> RequestId:
        """Return the request id of a packet; the rest of the packet may be invalid."""
        packet_id, sequence = struct.unpack_from(">HH", packet.ljust(4, b"\0"))
        return cls(packet_id=packet_id, sequence=sequence)


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """A telecommand that agrees with the dictionary."""

    id: RequestId
    ack: int
    telecommand: Telecommand
    values: dict[str, Value] = field(default_factory=dict)
    data: bytes = b""  # the BYTES argument
    parameters: tuple[tuple[Parameter, float], ...] = ()  # service 20: parameters and values
    elements: tuple[Request, ...] = ()  # the elements of a repeated group

    def text(self, name: str) -> str:
        """Return a text argument."""
        return str(self.values[name])

    def whole(self, name: str) -> int:
        """Return a whole-number argument."""
        return int(self.values[name])

    def number(self, name: str) -> float:
        """Return a numeric argument."""
        return float(self.values[name])


class TelecommandReader:
    """Checks length, CRC, addressee, service, subtype and every argument, in this order."""

    def __init__(self) -> None:
        self._services = {t.service for t in DICTIONARY.telecommands}
        self._known: dict[tuple[int, int, int | None], Telecommand] = {
            (t.service, t.subtype, t.function_id): t for t in DICTIONARY.telecommands
        }
        self._subtypes = {(t.service, t.subtype) for t in DICTIONARY.telecommands}
        self._layouts = {
            t.name: Layout([f for f in t.arguments[t.repeats :] if f.type is not Type.BYTES])
            for t in DICTIONARY.telecommands
        }
        self._parameters = {item.id: item for item in DICTIONARY.parameters}

    def read(self, packet: bytes) -> Request:
        """Return the request in a packet. Raises TcError."""
        tc = _unpack(packet)
        if tc.apid != APID_ESTIMATOR:
            raise TcError(Error.WRONG_APID, value=tc.apid)
        service, subtype = tc.pus_tc_sec_header.service, tc.pus_tc_sec_header.message_subtype
        if service not in self._services:
            raise TcError(Error.UNKNOWN_SERVICE, value=service)
        if (service, subtype) not in self._subtypes:
            raise TcError(Error.UNKNOWN_SUBTYPE, value=subtype)
        data = bytes(tc.app_data)
        function = None
        if service == 8:
            if len(data) < 2:
                raise TcError(Error.BAD_LENGTH, value=len(packet))
            function = int.from_bytes(data[:2], "big")
        telecommand = self._known.get((service, subtype, function))
        if telecommand is None:
            raise TcError(Error.BAD_ARG, 1, float(function or 0), "no such function")
        request_id, ack = RequestId.of(packet), tc.pus_tc_sec_header.ack_flags
        request = Request(id=request_id, ack=ack, telecommand=telecommand)
        if service == PARAMETERS:
            parameters = self._read_parameters(data, with_values=subtype == 3)
            return replace(request, parameters=parameters)
        if telecommand.repeats:
            return replace(request, elements=self._read_elements(request, data))
        values, rest = self._read_arguments(telecommand, data)
        return replace(request, values=values, data=rest)

    def _read_elements(self, request: Request, data: bytes) -> tuple[Request, ...]:
        """Return the elements of a repeated group, each as one request. Raises TcError."""
        if not data:
            raise TcError(Error.BAD_LENGTH)
        count, at = data[0], 1
        if not 1 <= count <= MAX_REPEATS:
            raise TcError(Error.OUT_OF_RANGE, 1, count)
        telecommand = request.telecommand
        fixed_bytes = self._layouts[telecommand.name].size_bytes
        width = len(telecommand.arguments) - 1
        pieces: list[bytes] = []
        for _ in range(count):
            size = fixed_bytes
            if telecommand.arguments[-1].type is Type.BYTES:
                size += _packet_bytes(data[at + fixed_bytes :])
            pieces.append(data[at : at + size])
            at += size
        if at != len(data):
            raise TcError(Error.BAD_LENGTH, value=len(data), text=f"{count} elements")
        if len(set(pieces)) < count:
            raise TcError(Error.BAD_ARG, text="an element is there twice")
        found = []
        for place, piece in enumerate(pieces):
            values, rest = self._read_arguments(telecommand, piece, 1 + place * width)
            found.append(replace(request, values=values, data=rest))
        return tuple(found)

    def _read_arguments(
        self, telecommand: Telecommand, data: bytes, before: int = 0
    ) -> tuple[dict[str, Value], bytes]:
        """Return values and BYTES argument; `before`: number of arguments before these."""
        layout = self._layouts[telecommand.name]
        open_ended = bool(telecommand.arguments) and telecommand.arguments[-1].type is Type.BYTES
        size = layout.size_bytes
        if len(data) < size + open_ended or (len(data) > size and not open_ended):
            raise TcError(Error.BAD_LENGTH, value=len(data), text=f"{size} bytes of arguments")
        values = layout.unpack(data[:size])
        start = 0
        for place, argument in enumerate(layout.fields, start=1 + before):
            raw = data[start : start + argument.size_bytes]
            _check(argument, place, values[argument.name], raw)
            start += argument.size_bytes
        return values, data[size:]

    def _read_parameters(
        self, data: bytes, *, with_values: bool
    ) -> tuple[tuple[Parameter, float], ...]:
        if not data:
            raise TcError(Error.BAD_LENGTH)
        count, at = data[0], 1
        if not 1 <= count <= MAX_REPEATS:
            raise TcError(Error.OUT_OF_RANGE, 1, count)
        found: list[tuple[Parameter, float]] = []
        for place in range(count):
            if len(data) < at + 2:
                raise TcError(Error.BAD_LENGTH, value=len(data))
            number = int.from_bytes(data[at : at + 2], "big")
            item = self._parameters.get(number)
            if item is None:
                raise TcError(Error.BAD_ARG, place + 2, number, "no such parameter")
            at += 2
            value = 0.0
            if with_values:
                layout = Layout([Field(name="value", type=item.type)])
                if len(data) < at + layout.size_bytes:
                    raise TcError(Error.BAD_LENGTH, value=len(data))
                value = float(layout.unpack(data[at : at + layout.size_bytes])["value"])
                at += layout.size_bytes
                if not item.minimum <= value <= item.maximum:
                    shown = value if math.isfinite(value) else 0.0
                    raise TcError(Error.OUT_OF_RANGE, place + 2, shown)
            found.append((item, value))
        if at != len(data):
            raise TcError(Error.BAD_LENGTH, value=len(data))
        if len({item.id for item, _ in found}) < count:
            raise TcError(Error.BAD_ARG, text="a parameter is named twice")
        return tuple(found)


def _packet_bytes(data: bytes) -> int:
    """Return the length of the first packet in the data, by its header [B]. Raises TcError."""
    if len(data) < TC_HEADER_BYTES + CRC_BYTES:
        raise TcError(Error.BAD_LENGTH, value=len(data), text="no whole telecommand packet")
    return int.from_bytes(data[4:6], "big") + 7


def _unpack(packet: bytes) -> PusTc:
    if len(packet) < TC_HEADER_BYTES + CRC_BYTES:
        raise TcError(Error.BAD_LENGTH, value=len(packet))
    declared = int.from_bytes(packet[4:6], "big") + 7
    if declared != len(packet):
        raise TcError(Error.BAD_LENGTH, value=len(packet))
    try:
        tc = PusTc.unpack(packet)
    except InvalidTcCrc16Error as error:
        raise TcError(Error.BAD_CRC) from error
    except BytesTooShortError as error:
        raise TcError(Error.BAD_LENGTH, value=len(packet)) from error
    except ValueError as error:  # another PUS version
        raise TcError(Error.BAD_ARG, text=str(error)) from error
    header = tc.sp_header
    whole = header.seq_flags == SequenceFlags.UNSEGMENTED
    if packet[0] & 0xF8 != 0x18 or not whole:
        raise TcError(Error.BAD_ARG, text="no unsegmented telecommand")
    return tc


def _check(argument: Field, place: int, value: Value, raw: bytes) -> None:
    """Raise TcError unless the dictionary allows the value."""
    if argument.type is Type.TEXT:
        raw = raw.rstrip(b"\0")
        held = 0 < len(raw) < argument.size and b"\0" not in raw  # at least one zero ends it
        if not held or not raw.isascii() or not raw.decode("ascii").isprintable():
            raise TcError(Error.BAD_ARG, place)
        return
    number = float(value)
    if argument.enumeration is not None and value not in argument.enumeration.labels:
        raise TcError(Error.BAD_ARG, place, number)
    if not math.isfinite(number):
        raise TcError(Error.OUT_OF_RANGE, place)
    low = -math.inf if argument.minimum is None else argument.minimum
    high = math.inf if argument.maximum is None else argument.maximum
    if not low <= number <= high:
        raise TcError(Error.OUT_OF_RANGE, place, number)
