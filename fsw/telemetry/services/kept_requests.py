"""Telecommands that are stored on board: their checks and their form in a document."""

import struct
from collections.abc import Collection
from typing import Any

from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.dictionary.onboard_commands import MAX_REQUEST_BYTES
from fsw.telemetry.link.packets import HEADER_BYTES, TC_HEADER_BYTES
from fsw.telemetry.link.telecommands import Request, RequestId, TcError
from fsw.telemetry.services.executor import TelecommandExecutor

PACKET_ID = 0x1800  # type telecommand, secondary header; the APID is added
UNSEGMENTED = 0xC000


def checked_request(
    executor: TelecommandExecutor, packet: bytes, argument: int, barred: Collection[int] = ()
) -> Request:
    """Return the request in a packet that is to be stored on board.

    Parameters
    ----------
    argument : number of the argument that holds the packet
    barred : services whose telecommands cannot be stored there

    Raises
    ------
    TcError when the packet is too long, is not a telecommand of the dictionary, or is barred.
    """
    if len(packet) > MAX_REQUEST_BYTES:
        raise TcError(Error.BAD_LENGTH, argument, len(packet), f"{MAX_REQUEST_BYTES} bytes at most")
    request = executor.check(packet)
    if request.telecommand.service in barred:
        text = f"{request.telecommand.name} cannot be kept here"
        raise TcError(Error.BAD_ARG, argument, request.telecommand.service, text)
    return request


def is_request(source: int, apid: int, sequence_count: int, packet: bytes) -> bool:
    """Return whether a packet is the one that the standard's request identifier names."""
    wanted = RequestId(packet_id=PACKET_ID | apid, sequence=UNSEGMENTED | sequence_count)
    return RequestId.of(packet) == wanted and source_of(packet) == source


def source_of(packet: bytes) -> int:
    """Return the source id of a telecommand packet; 0 if the packet is too short."""
    if len(packet) < TC_HEADER_BYTES:
        return 0
    return int(struct.unpack_from(">H", packet, TC_HEADER_BYTES - 2)[0])


def split_first(data: bytes) -> bytes:
    """Return the first packet in the data. Raises TcError BAD_LENGTH if it is incomplete."""
    if len(data) >= HEADER_BYTES:
        length = int.from_bytes(data[4:6], "big") + HEADER_BYTES + 1
        if length <= len(data):
            return data[:length]
    raise TcError(Error.BAD_LENGTH, value=len(data), text="no whole telecommand packet")


def packet_of(value: Any) -> bytes:  # noqa: ANN401
    """Return the packet in a document's hexadecimal value. Raises TypeError or ValueError."""
    if not isinstance(value, str):
        raise TypeError("a kept telecommand must be hexadecimal text")
    return bytes.fromhex(value)
