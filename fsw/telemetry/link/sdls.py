"""Authenticated telecommand frames: a profile of CCSDS 355.0-B (SDLS) on TC frames of 232.0-B.

    header 5 | SPI 2 | IV 12 | encrypted data | MAC 16 | FECF 2        [bytes, big-endian]

Frames are of type BD, on one virtual channel, without segment header, under AES-256-GCM. The IV is
a sequence number of 6 bytes followed by 6 random bytes of the sender. Read as one number of 96 bits
it rises from frame to frame; a sender that lost its numbers still never repeats an IV. The
additional authenticated data are header and security header under a mask: spacecraft, virtual
channel and SPI, all other bits zero (GCM authenticates the IV as nonce). The standard's own mask
leaves the spacecraft out, so that a frame for one robot could be readdressed to another that has
the same key. Bits outside the mask must have their only allowed value. The data are whole
telecommand packets.

Not certified; no extended procedures (keys are files), no COP-1.
"""

import hashlib
import struct
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import fastcrc
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

HEADER_BYTES, SPI_BYTES, IV_BYTES, MAC_BYTES, FECF_BYTES = 5, 2, 12, 16, 2
RANDOM_BITS = 48  # random bits: the low half of the IV
RESERVE = 16  # numbers stored ahead: one write per 16 commands; a crash skips at most 16
DATA_AT = HEADER_BYTES + SPI_BYTES + IV_BYTES
MIN_BYTES = DATA_AT + 1 + MAC_BYTES + FECF_BYTES
MAX_BYTES = 1024  # 232.0-B 4.1.2: ten bits of length
BYPASS = 1 << 13  # type BD; the other bits are zero: version, control command flag, spare
SPACECRAFT_MASK, VCID_MASK = 0x03FF, 0xFC
PACKET_HEADER_BYTES = 6
PATIENCE_NS = 500_000_000  # longest wait for the rest of a frame
TC_PACKET_MASK, TC_PACKET = 0xF8, 0x18  # version 0, type telecommand, secondary header
_HEADER = struct.Struct(">HHB")


class FrameReject(StrEnum):
    """Reason for which a frame on the uplink was rejected; the names are those of telemetry."""

    BAD_LENGTH = "BAD_LENGTH"
    BAD_CRC = "BAD_CRC"
    NOT_AUTHENTICATED = "NOT_AUTHENTICATED"
    REPLAY = "REPLAY"
    NOT_KEPT = "NOT_KEPT"


class Role(StrEnum):
    """Permission that a key gives its holder."""

    COMMAND = "command"
    LOOK = "look"  # its frames are authentic, but their telecommands are rejected
    TELEMETRY = "telemetry"  # the daemon encrypts and authenticates telemetry with it


@dataclass(frozen=True, slots=True, kw_only=True)
class Association:
    """One security association: a security parameter index (SPI) with its key and role."""

    spi: int
    key: bytes = field(repr=False)
    role: Role = Role.COMMAND

    @property
    def fingerprint(self) -> str:
        """Return the name of the key in the file of used numbers."""
        return hashlib.sha256(self.key).hexdigest()[:16]


@dataclass(frozen=True, slots=True, kw_only=True)
class Accepted:
    """Data of an authentic frame that was not received before."""

    packet: bytes
    spi: int
    number: int
    role: Role = Role.COMMAND


@dataclass(frozen=True, slots=True, kw_only=True)
class Rejected:
    """A rejected frame. An authentic repeated one has a packet and the next acceptable number."""

    reason: FrameReject
    text: str
    packet: bytes | None = None
    next_number: int | None = None


class FrameNumbers(Protocol):
    """Stores the lowest acceptable IV of each key, a number of 96 bits."""

    def floor(self, fingerprint: str) -> int:
        """Return the lowest IV that was never used with a key."""
        ...

    def is_retired(self, fingerprint: str) -> bool:
        """Return whether the key must never be accepted again."""
        ...

    def claim(self, fingerprint: str, used: int, kept: int) -> None:
        """Mark IVs up to `used` as used; after a crash those below `kept` too. Raises OSError."""
        ...

    def skip(self, fingerprint: str, used: int) -> None:
        """Mark IVs up to `used` as used in this run only: a restart may accept them again."""
        ...

    def settle(self, floors: Mapping[str, int]) -> None:
        """Store exactly these lowest unused IVs, by key fingerprint. Raises OSError."""
        ...


def nothing_rescues(_packets: bytes) -> bool:
    """Return False: no telecommand is accepted when its number cannot be stored."""
    return False


class FrameReceiver:
    """Checks frames; only a frame that `receive` accepts may have an effect.

    Parameters
    ----------
    associations : the keys, each under its own SPI
    numbers : stored IVs
    window : count of acceptable sequence numbers, which begin at the lowest unused number
    names_spacecraft : whether the spacecraft is authenticated; the standard's own mask omits it
    rescues : returns whether the packets of a frame help against a failed disk; such a frame is
        accepted also when its number cannot be stored
    """

    def __init__(
        self,
        associations: Sequence[Association],
        numbers: FrameNumbers,
        *,
        spacecraft_id: int,
        virtual_channel: int,
        window: int,
        names_spacecraft: bool = True,
        rescues: Callable[[bytes], bool] = nothing_rescues,
    ) -> None:
        self.use(associations)
        self._numbers, self._window, self._rescues = numbers, window, rescues
        self._first, self._channel = BYPASS | spacecraft_id, virtual_channel
        self._mask = SPACECRAFT_MASK * names_spacecraft
        self.accepted = 0
        self.rejected: Counter[FrameReject] = Counter()

    def use(self, associations: Sequence[Association]) -> None:
        """Accept these keys from now on, and no others."""
        self._associations = {item.spi: item for item in associations}
        self._ciphers = {item.spi: AESGCM(item.key) for item in associations}

    def settle(self) -> None:
        """Store the exact lowest unused IVs, so that the next crash skips none. Raises OSError."""
        names = [item.fingerprint for item in self._associations.values()]
        self._numbers.settle({name: self._numbers.floor(name) for name in names})

    def matches(self, header: bytes) -> int | None:
        """Return the length of the frame that 5 bytes begin [B]; None if they begin no frame."""
        first, second, sequence = _HEADER.unpack_from(header)
        length = int(second & 0x3FF) + 1
        ours = (first, second >> 10, sequence) == (self._first, self._channel, 0)
        return length if ours and length >= MIN_BYTES else None

    def receive(self, frame: bytes) -> Accepted | Rejected:
        """Check form, authenticity and freshness of one frame, in this order; count the outcome."""
        outcome = self._check(frame)
        if isinstance(outcome, Accepted):
            self.accepted += 1
        else:
            self.rejected[outcome.reason] += 1
        return outcome

    def refuse(self, reason: FrameReject) -> None:
        """Count bytes that were rejected before they formed a frame."""
        self.rejected[reason] += 1

    def next_number(self, spi: int) -> int | None:
        """Return the lowest acceptable number of an SPI; None if the SPI has no accepted key."""
        association = self._associations.get(spi)
        if association is None or self._numbers.is_retired(association.fingerprint):
            return None
        return _next_number(self._numbers.floor(association.fingerprint))

    def _check(self, frame: bytes) -> Accepted | Rejected:
        if not MIN_BYTES <= len(frame) <= MAX_BYTES:
            text = f"{len(frame)} bytes; must be {MIN_BYTES} to {MAX_BYTES}"
            return Rejected(reason=FrameReject.BAD_LENGTH, text=text)
        if not has_good_fecf(frame):
            return Rejected(reason=FrameReject.BAD_CRC, text="frame error control field")
        if self.matches(frame[:HEADER_BYTES]) != len(frame):  # bits outside the MAC
            return _forged("primary header")
        (spi,) = struct.unpack_from(">H", frame, HEADER_BYTES)
        association = self._associations.get(spi)
        if association is None or self._numbers.is_retired(association.fingerprint):
            return _forged(f"SPI {spi} has no key")
        iv = frame[DATA_AT - IV_BYTES : DATA_AT]
        sealed = frame[DATA_AT:-FECF_BYTES]
        try:
            packet = self._ciphers[spi].decrypt(iv, sealed, masked_header(frame, self._mask))
        except InvalidTag:
            return _forged(f"MAC under SPI {spi}")
        return self._claim(association, int.from_bytes(iv, "big"), packet)

    def _claim(self, association: Association, iv: int, packet: bytes) -> Accepted | Rejected:
        floor, number = self._numbers.floor(association.fingerprint), iv >> RANDOM_BITS
        following = _next_number(floor)
        if iv < floor or number >= following + self._window:
            text = f"number {number}; accepted are {following} to {following + self._window - 1}"
            return Rejected(
                reason=FrameReject.REPLAY, text=text, packet=packet, next_number=following
            )
        # some senders count the whole IV up by one: store ahead in steps of that
        counts_all = iv - floor < RESERVE
        kept = iv + 1 + RESERVE if counts_all else (number + 1 + RESERVE) << RANDOM_BITS
        try:
            self._numbers.claim(association.fingerprint, iv, kept)
        except OSError as error:  # not stored, the frame could be replayed after a restart
            if not self._rescues(packet):
                text = f"number {number} cannot be kept: {error.strerror or error}"
                return Rejected(reason=FrameReject.NOT_KEPT, text=text, packet=packet)
            self._numbers.skip(association.fingerprint, iv)
        return Accepted(packet=packet, spi=association.spi, number=number, role=association.role)


class FrameSplitter:
    """Cuts a byte stream into frames, and rejects telecommand packets in clear.

    Bytes that could begin a frame or packet wait for their rest, at most 1 KiB and at most
    `PATIENCE_NS`. All other bytes are skipped one by one and counted, until a frame or packet with
    a correct CRC begins.
    """

    def __init__(self, receiver: FrameReceiver) -> None:
        self._receiver = receiver
        self._buffer = bytearray()
        self._last_ns = 0
        self._in_sync = True
        self.skipped_bytes = 0
        self.resyncs = 0  # number of times that invalid bytes began

    def feed(self, chunk: bytes, now_ns: int = 0) -> list[Accepted | Rejected]:
        """Return the outcome of every frame and clear packet that ends in this chunk."""
        self._buffer += chunk
        self._last_ns = now_ns
        return self._cut()

    def expire(self, now_ns: int) -> list[Accepted | Rejected]:
        """Discard an item whose rest did not arrive in time; return the outcomes after it."""
        if not self._buffer or now_ns - self._last_ns < PATIENCE_NS:
            return []
        self._skip()
        return self._cut()

    def _cut(self) -> list[Accepted | Rejected]:
        outcomes: list[Accepted | Rejected] = []
        while len(self._buffer) >= PACKET_HEADER_BYTES:
            head = bytes(self._buffer[:PACKET_HEADER_BYTES])
            length = self._receiver.matches(head) or _clear_packet_bytes(head)
            if length is None:
                self._skip()
                continue
            if len(self._buffer) < length:
                break
            item = bytes(self._buffer[:length])
            if not has_good_fecf(item):  # packets end in the same CRC
                self._receiver.refuse(FrameReject.BAD_CRC)
                self._skip()
                continue
            del self._buffer[:length]
            self._in_sync = True
            outcomes.append(self._take(item))
        return outcomes

    def _skip(self) -> None:
        del self._buffer[:1]
        self.skipped_bytes += 1
        self.resyncs += self._in_sync
        self._in_sync = False

    def _take(self, item: bytes) -> Accepted | Rejected:
        if item[0] & TC_PACKET_MASK != TC_PACKET:
            return self._receiver.receive(item)
        self._receiver.refuse(FrameReject.NOT_AUTHENTICATED)
        return Rejected(
            reason=FrameReject.NOT_AUTHENTICATED, text="telecommand in clear", packet=item
        )


def masked_header(frame: bytes, first_mask: int) -> bytes:
    """Return the additional authenticated data of a frame.

    `first_mask` is the mask of the header's first two bytes.
    Source: CCSDS 355.0-B-2, authentication bit mask of TC frames: VCID and SPI.
    """
    first = int.from_bytes(frame[:2], "big") & first_mask
    spi = frame[HEADER_BYTES : HEADER_BYTES + SPI_BYTES]
    header = first.to_bytes(2, "big") + bytes((frame[2] & VCID_MASK, 0, 0))
    return header + spi + bytes(IV_BYTES)


def _next_number(floor: int) -> int:
    """Return the lowest sequence number whose IVs all lie at or above the IV `floor`."""
    return -(-floor >> RANDOM_BITS)


def has_good_fecf(frame: bytes) -> bool:
    """Return whether the last two bytes are the CRC-16 CCITT-FALSE of all bytes before them."""
    return fastcrc.crc16.ibm_3740(frame[:-FECF_BYTES]) == int.from_bytes(frame[-FECF_BYTES:], "big")


def _clear_packet_bytes(head: bytes) -> int | None:
    length = int.from_bytes(head[4:6], "big") + PACKET_HEADER_BYTES + 1
    if head[0] & TC_PACKET_MASK != TC_PACKET or length > MAX_BYTES:
        return None
    return length


def _forged(text: str) -> Rejected:
    return Rejected(reason=FrameReject.NOT_AUTHENTICATED, text=text)
