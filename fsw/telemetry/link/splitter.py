"""The uplink in clear: cuts a byte stream into space packets and skips invalid bytes."""

from dataclasses import dataclass

from fastcrc import crc16

from fsw.telemetry.dictionary import DICTIONARY, Type
from fsw.telemetry.dictionary.codes import APID_FILES, Error
from fsw.telemetry.link.packets import CRC_BYTES, HEADER_BYTES, TC_HEADER_BYTES

MAX_PACKET_BYTES = 2048
PATIENCE_NS = 500_000_000  # longest wait for a packet's rest; then its first byte is invalid
TC_MASK, TC_BITS = 0xF8, 0x18  # version 0, telecommand, secondary header
FILE_ID = 0x1000 | APID_FILES
CARRIERS = frozenset(  # service and subtype of telecommands that contain telecommands
    (item.service, item.subtype)
    for item in DICTIONARY.telecommands
    if any(field.type is Type.BYTES for field in item.arguments)
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Uplinked:
    """One packet from the ground, accepted or rejected; file packets have no CRC."""

    packet: bytes
    error: Error | None = None
    text: str = ""
    value: float = 0.0  # number to report with the error
    source: str = ""  # name of the sender

    @property
    def is_file(self) -> bool:
        """Return whether the packet belongs to file delivery."""
        return int.from_bytes(self.packet[:2], "big") == FILE_ID


class PacketSplitter:
    """Cuts one client's bytes into packets; skips and counts bytes that begin no packet.

    Parameters
    ----------
    known_id : packets with this packet id are returned even when their CRC is wrong
    """

    def __init__(self, known_id: int) -> None:
        self._known = known_id
        self._buffer = bytearray()
        self._last_ns = 0
        self._in_sync = True
        self.skipped_bytes = 0
        self.resyncs = 0  # number of times that invalid bytes began

    @property
    def pending_bytes(self) -> int:
        """Return the number of buffered bytes, which may begin a packet."""
        return len(self._buffer)

    def feed(self, chunk: bytes, now_ns: int) -> list[Uplinked]:
        """Return the packets that end in this chunk."""
        self._buffer += chunk
        self._last_ns = now_ns
        return self._cut()

    def expire(self, now_ns: int) -> list[Uplinked]:
        """Discard a packet whose rest did not arrive in time; return the packets after it."""
        found: list[Uplinked] = []
        if self._buffer and now_ns - self._last_ns >= PATIENCE_NS:
            self._skip(1)
            found = self._cut()
        return found

    def _cut(self) -> list[Uplinked]:
        found = []
        while len(self._buffer) >= HEADER_BYTES:
            length = _length(self._buffer)
            if length is None:
                self._skip(1)
                continue
            if len(self._buffer) < length:
                break
            packet = bytes(self._buffer[:length])
            identity = int.from_bytes(packet[:2], "big")
            good = identity == FILE_ID or crc16.ibm_3740(packet) == 0
            if good or identity == self._known:
                found.append(Uplinked(packet=packet, error=None if good else Error.BAD_CRC))
            if good:
                del self._buffer[:length]
                self._in_sync = True
            else:
                self._skip(length if _carries(packet) and self._ends_whole(length) else 1)
        return found

    def _ends_whole(self, length: int) -> bool:
        """Return whether a packet ends at the next packet's start or at the last received byte."""
        rest = self._buffer[length:]
        return not rest or _is_packet_id(rest)

    def _skip(self, count: int) -> None:
        del self._buffer[:count]
        self.skipped_bytes += count
        if self._in_sync:
            self._in_sync = False
            self.resyncs += 1


def _carries(packet: bytes) -> bool:
    """Return whether a damaged packet contains telecommands, which must then not be executed."""
    return packet[0] & TC_MASK == TC_BITS and tuple(packet[7:9]) in CARRIERS


def _is_packet_id(buffer: bytearray) -> bool:
    """Return whether the bytes so far can begin a telecommand or a packet of file delivery."""
    return buffer[0] & TC_MASK == TC_BITS or buffer[:2] == FILE_ID.to_bytes(2, "big")[: len(buffer)]


def _length(buffer: bytearray) -> int | None:
    """Return the length of the packet that the bytes begin [B]; None if they begin no packet."""
    identity = buffer[0] << 8 | buffer[1]
    length = (buffer[4] << 8 | buffer[5]) + HEADER_BYTES + 1
    if length > MAX_PACKET_BYTES:
        return None
    if identity == FILE_ID:
        return length
    if buffer[0] & TC_MASK != TC_BITS or length < TC_HEADER_BYTES + CRC_BYTES:
        return None
    return length
