"""Telemetry packets by the XTCE."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fastcrc import crc16
from space_packet_parser import SpacePacket, load_xtce
from space_packet_parser.exceptions import UnrecognizedPacketTypeError

from ground.dictionary import XTCE
from ground.errors import LinkError

HEADER_BYTES = 6
MAX_PACKET_BYTES = 65542
FILE_APID = 101  # its packets carry CFDP units and have no CRC
FRACTIONS_PER_S = 1 << 24
SHARED = "service_"  # begins the name of what tells packets of one service and subtype apart
KIND = ("header_apid", "header_service", "header_subtype")

Value = int | float | str


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """One decoded packet."""

    packet: str
    service: int
    subtype: int
    time_s: float  # mission elapsed; NaN when the packet has no time
    values: Mapping[str, Value]


def split(buffer: bytearray) -> Iterator[bytes]:
    """Take whole packets from the front of a buffer. Raises LinkError when it holds none."""
    while len(buffer) >= HEADER_BYTES:
        length = (buffer[4] << 8 | buffer[5]) + HEADER_BYTES + 1
        if buffer[0] >> 4 != 0:  # version 0, telemetry
            raise LinkError("what the daemon sends is no telemetry packet")
        if len(buffer) < length:
            return
        packet = bytes(buffer[:length])
        del buffer[:length]
        if apid(packet) != FILE_APID and crc16.ibm_3740(packet) != 0:
            raise LinkError("a telemetry packet with a wrong CRC")
        yield packet


def apid(packet: bytes) -> int:
    """Return the application a packet comes from."""
    return (packet[0] << 8 | packet[1]) & 0x7FF


class Decoder:
    """Decodes packets; one XTCE for all."""

    def __init__(self, path: Path = XTCE) -> None:
        self._definition = load_xtce(path)
        self._names: dict[tuple[Value | None, ...], str] = {}

    def decode(self, packet: bytes) -> Sample | None:
        """Return what a packet says; None of one that the dictionary does not have."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a packet longer than the dictionary has it
            try:
                parsed = self._definition.parse_bytes(packet)
            except (UnrecognizedPacketTypeError, ValueError):
                return None
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
        """Return the name of the container a packet was read by."""
        told_by = next((v for k, v in parsed.items() if k.startswith(SHARED)), None)
        kind = tuple(parsed.get(key) for key in KIND)
        if (*kind, told_by) not in self._names:
            self._names[*kind, told_by] = self._descend(parsed)
        return self._names[*kind, told_by]

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


def _plain(value: Any) -> Value:  # noqa: ANN401
    """Return a value of the reader's own types as a plain one."""
    if isinstance(value, str):
        return str(value)
    return float(value) if isinstance(value, float) else int(value)


def _time_s(parsed: SpacePacket) -> float:
    """Return the mission elapsed time of a packet."""
    if "header_time_coarse_s" in parsed:
        coarse, fine = parsed["header_time_coarse_s"], parsed["header_time_fine"]
    elif "time_coarse_s" in parsed:
        coarse, fine = parsed["time_coarse_s"], parsed["time_fine"]
    else:
        return math.nan
    return int(coarse) + int(fine) / FRACTIONS_PER_S
