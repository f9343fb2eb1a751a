"""Splits a byte stream into telemetry packets and decodes them by the XTCE dictionary."""

import math
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fastcrc import crc16
from space_packet_parser import SpacePacket, load_xtce

from ground.dictionary import XTCE
from ground.errors import LinkError, UsageError, did_you_mean

HEADER_BYTES = 6
MAX_PACKET_BYTES = 65542
FILE_APID = 101  # its packets carry CFDP units and have no CRC
FRACTIONS_PER_S = 1 << 24
SHARED = "service_"  # prefix of the field that distinguishes packets of one service and subtype
KIND = ("header_apid", "header_service", "header_subtype")
HEADER, CRC = "header_", "crc16"  # names around a packet's own fields
UNKNOWN = "unknown"  # name of a packet that is not in the dictionary
FILE_UNIT = "file_unit"  # name of a packet of file delivery
NO_PACKETS = (UNKNOWN, FILE_UNIT)  # names without fields in the dictionary
RAW_BYTES = 64  # most bytes of an unknown packet that are shown

Value = int | float | str


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """One decoded packet."""

    packet: str
    service: int
    subtype: int
    time_s: float  # mission elapsed time; NaN when the packet has none
    values: Mapping[str, Value]


def split(buffer: bytearray) -> Iterator[bytes]:
    """Yield whole packets and remove them from the buffer. Raises LinkError if one is invalid."""
    while len(buffer) >= HEADER_BYTES:
        length = (buffer[4] << 8 | buffer[5]) + HEADER_BYTES + 1
        if buffer[0] >> 4 != 0:  # version 0, telemetry
            raise LinkError("what the daemon sends is not a telemetry packet")
        if len(buffer) < length:
            return
        packet = bytes(buffer[:length])
        del buffer[:length]
        if apid(packet) != FILE_APID and crc16.ibm_3740(packet) != 0:
            raise LinkError("a telemetry packet with a wrong CRC")
        yield packet


def apid(packet: bytes) -> int:
    """Return the application process identifier (APID) of a packet."""
    return (packet[0] << 8 | packet[1]) & 0x7FF


class TelemetryDecoder:
    """Decodes telemetry packets by an XTCE file."""

    def __init__(self, path: Path = XTCE) -> None:
        self._definition = load_xtce(path)
        self._names: dict[tuple[Value | None, ...], str] = {}

    @property
    def fields(self) -> dict[str, tuple[str, ...]]:
        """Return the field names of every packet."""
        return {
            name: tuple(
                entry.name.removeprefix(f"{name}_")
                for entry in container.entry_list
                if not entry.name.startswith((HEADER, SHARED)) and entry.name != CRC
            )
            for name, container in self._definition.containers.items()
            if not container.abstract
        }

    def decode(self, packet: bytes) -> Sample:
        """Return the content of a packet.

        The sample of a packet that does not fit the dictionary is named `unknown` and holds its
        identification and first bytes; a packet of file delivery is named `file_unit`.
        """
        if apid(packet) == FILE_APID:
            return _sample(FILE_UNIT, {"size_bytes": len(packet)})
        try:
            return self._parsed(packet)
        except Exception as error:  # noqa: BLE001  the parser raises errors of many kinds
            return _unknown(packet, error)

    def _parsed(self, packet: bytes) -> Sample:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about packets longer than in the dictionary
            parsed = self._definition.parse_bytes(packet)
        name = self._name(parsed)
        prefix = f"{name}_"
        return Sample(
            packet=name,
            service=int(parsed.get("header_service", 0)),
            subtype=int(parsed.get("header_subtype", 0)),
            time_s=_time_s(parsed),
            values={
                key.removeprefix(prefix): _plain(value)
                for key, value in parsed.items()
                if key.startswith(prefix)
            },
        )

    def _name(self, parsed: SpacePacket) -> str:
        """Return the name of the XTCE container that describes a packet."""
        told_by = tuple(v for k, v in parsed.items() if k.startswith(SHARED))
        kind = tuple(parsed.get(key) for key in KIND)
        if (*kind, *told_by) not in self._names:
            self._names[*kind, *told_by] = self._descend(parsed)
        return self._names[*kind, *told_by]

    def _descend(self, parsed: SpacePacket) -> str:
        containers = self._definition.containers
        name = str(self._definition.root_container_name)
        while True:
            fitting = (
                inner
                for inner in containers[name].inheritors
                if all(c.evaluate(parsed) for c in containers[inner].restriction_criteria)
            )
            inner = next(fitting, None)
            if inner is None:
                return name
            name = str(inner)


def check_names(
    known: Mapping[str, Iterable[str]], packets: Iterable[str], fields: Iterable[str]
) -> None:
    """Check the names of packets, and of fields that at least one of the packets must have.

    Parameters
    ----------
    known : fields of every packet
    packets : chosen packets; none: all

    Raises
    ------
    UsageError with the wrong name and similar known names.
    """
    chosen = list(packets) or list(known)
    for name in chosen:
        if name not in known and name not in NO_PACKETS:
            raise UsageError(f"{name}: no such packet{did_you_mean(name, known)}")
    there = {field for name in chosen for field in known.get(name, ())}
    for name in fields:
        if name not in there:
            raise UsageError(f"{name}: no such field in what is shown{did_you_mean(name, there)}")


def _sample(name: str, values: Mapping[str, Value]) -> Sample:
    return Sample(packet=name, service=0, subtype=0, time_s=math.nan, values=values)


def _unknown(packet: bytes, error: Exception) -> Sample:
    """Return the sample of an unknown packet: header values, the parser's error, first bytes."""
    values: dict[str, Value] = {"apid": apid(packet), "size_bytes": len(packet)}
    has_header = packet[0] & 0x08 and len(packet) > HEADER_BYTES + 2
    if has_header:
        values |= {"service": packet[7], "subtype": packet[8]}
    values |= {"reason": type(error).__name__, "raw": packet[:RAW_BYTES].hex()}
    return _sample(UNKNOWN, values)


def _plain(value: Any) -> Value:  # noqa: ANN401
    """Return a value of the parser's types as a plain str, float or int."""
    if isinstance(value, str):
        return shown(value)
    return float(value) if isinstance(value, float) else int(value)


def shown(text: str) -> str:
    """Return text that a terminal can show: other characters as escapes (backslash, x1b)."""
    return text if text.isprintable() else "".join(map(_shown, text))


def _shown(character: str) -> str:
    return character if character.isprintable() else ascii(character)[1:-1]


def _time_s(parsed: SpacePacket) -> float:
    """Return the mission elapsed time of a packet [s]; NaN if it has none."""
    if "header_time_coarse_s" in parsed:
        coarse, fine = parsed["header_time_coarse_s"], parsed["header_time_fine"]
    elif "time_coarse_s" in parsed:
        coarse, fine = parsed["time_coarse_s"], parsed["time_fine"]
    else:
        return math.nan
    return int(coarse) + int(fine) / FRACTIONS_PER_S
