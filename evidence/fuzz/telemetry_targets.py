"""Targets for the ground link: telecommand packets in clear, and authenticated frames."""

import binascii
from collections.abc import Callable, Mapping
from itertools import pairwise

from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes

from evidence.fuzz.oracle import Target, chunks, require
from fsw.telemetry.dictionary.codes import APID_ESTIMATOR, APID_FILES
from fsw.telemetry.link.packets import telecommand_packet
from fsw.telemetry.link.sdls import RANDOM_BITS, Accepted, Association, FrameReceiver, FrameSplitter
from fsw.telemetry.link.splitter import PATIENCE_NS, PacketSplitter
from fsw.telemetry.link.telecommands import TcError, TelecommandReader

KEY, SPI, CHANNEL, SPACECRAFT = bytes(range(32)), 7, 3, 42
MAX_PENDING_BYTES = 2048
KNOWN_ID = 0x1800 | APID_ESTIMATOR


def with_crc(body: bytes) -> bytes:
    """Return the body with its CRC-16 CCITT-FALSE appended."""
    return body + binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "big")


def seal_packet(payload: bytes) -> bytes:
    """Return a telecommand packet to the estimator, or a file packet if the first byte is 0xFF."""
    files = bool(payload) and payload[0] == 0xFF
    identity = (0x1000 | APID_FILES) if files else KNOWN_ID
    data = payload[1:] if files else payload.ljust(5, b"\0")
    length = max(len(data) + (0 if files else 2), 1) - 1
    head = identity.to_bytes(2, "big") + b"\xc0\x01" + length.to_bytes(2, "big")
    return head + (data or b"\0") if files else with_crc(head + data)


def packet_target() -> Target:
    """Return the target of the uplink in clear: packet splitter, then telecommand reader."""
    reader = TelecommandReader()

    def one(data: bytes) -> None:
        splitter = PacketSplitter(KNOWN_ID)
        pieces = chunks(data, seal_packet)
        good = 0
        for k, piece in enumerate(pieces):
            for found in splitter.feed(piece, k):
                good += len(found.packet) if found.error is None else 0
                if not found.is_file:
                    check_telecommand(reader, found.packet)
            require(splitter.pending_bytes <= MAX_PENDING_BYTES, "buffer grows")
        now_ns = len(pieces)
        while splitter.pending_bytes:
            now_ns += PATIENCE_NS
            before = splitter.pending_bytes
            for found in splitter.expire(now_ns):
                good += len(found.packet) if found.error is None else 0
            if splitter.pending_bytes == before:
                break
        total = sum(map(len, pieces))
        counted = good + splitter.skipped_bytes + splitter.pending_bytes
        require(counted == total, "bytes are lost", counted, total)

    return one


def check_telecommand(reader: TelecommandReader, packet: bytes) -> None:
    """Read a packet; build an accepted telecommand again and require the same arguments."""
    try:
        request = reader.read(packet)
    except TcError as error:
        require(error.error is not None, "a refusal without a code")
        return
    if request.parameters or len(request.elements) > 1:
        return
    arguments = request.telecommand.arguments[request.telecommand.repeats :]
    request = request.elements[0] if request.elements else request
    values: dict[str, object] = {**request.values}
    for field in arguments:
        if field.name not in values:
            values[field.name] = request.data
    again = telecommand_packet(
        request.telecommand, values, request.id.sequence & 0x3FFF, ack=request.ack
    )
    require(again[11:-2] == packet[11:-2], "not the same arguments again", packet, again)


class Unkept:
    """The initialisation vectors (IV) used so far, kept in memory only."""

    def __init__(self) -> None:
        self.next = 0

    def floor(self, fingerprint: str) -> int:  # noqa: ARG002
        """Return the lowest IV that was never used."""
        return self.next

    def is_retired(self, fingerprint: str) -> bool:  # noqa: ARG002
        """Return False: no key is ever retired."""
        return False

    def claim(self, fingerprint: str, used: int, kept: int) -> None:  # noqa: ARG002
        """Mark all IVs up to `used` as used."""
        self.next = used + 1

    def skip(self, fingerprint: str, used: int) -> None:  # noqa: ARG002
        """Mark all IVs up to `used` as used."""
        self.next = used + 1

    def settle(self, floors: Mapping[str, int]) -> None:
        """Do nothing."""


def sealer() -> Callable[[bytes], bytes]:
    """Return an encoder of authentic frames; the first byte (signed) is added to the number."""
    following = 0

    def seal(payload: bytes) -> bytes:
        nonlocal following
        data = payload[1:].ljust(1, b"\0")
        number = max(0, following + int.from_bytes(payload[:1], "big", signed=True))
        following = number + 1
        length = 5 + 2 + 12 + len(data) + 16 + 2
        head = (0x2000 | SPACECRAFT).to_bytes(2, "big")
        head += (CHANNEL << 10 | length - 1).to_bytes(2, "big") + b"\0"
        iv, spi = (number << RANDOM_BITS).to_bytes(12, "big"), SPI.to_bytes(2, "big")
        cipher = Cipher(algorithms.AES(KEY), modes.GCM(iv)).encryptor()
        cipher.authenticate_additional_data(b"\0\0" + bytes((CHANNEL << 2, 0, 0)) + spi + bytes(12))
        sealed = cipher.update(data) + cipher.finalize() + cipher.tag
        return with_crc(head + spi + iv + sealed)

    return seal


def frame_target() -> Target:
    """Return the target of authenticated frames: frame splitter and receiver."""

    def one(data: bytes) -> None:
        numbers = Unkept()
        receiver = FrameReceiver(
            [Association(spi=SPI, key=KEY)],
            numbers,
            spacecraft_id=SPACECRAFT,
            virtual_channel=CHANNEL,
            window=64,
        )
        splitter = FrameSplitter(receiver)
        pieces = chunks(data, sealer())
        taken: list[int] = []
        outcomes = 0
        for piece in pieces:
            for outcome in splitter.feed(piece):
                outcomes += 1
                if isinstance(outcome, Accepted):
                    taken.append(outcome.number)
        require(all(b > a for a, b in pairwise(taken)), "replayed", taken)
        require(receiver.accepted == len(taken), "accepted", receiver.accepted)
        require(sum(receiver.rejected.values()) >= outcomes - len(taken), "rejected", outcomes)
        whole = FrameSplitter(
            FrameReceiver(
                [Association(spi=SPI, key=KEY)],
                Unkept(),
                spacecraft_id=SPACECRAFT,
                virtual_channel=CHANNEL,
                window=64,
            )
        )
        again = whole.feed(b"".join(pieces))
        require(len(again) == outcomes, "depends on the pieces", len(again), outcomes)
        total = sum(map(len, pieces))
        require(whole.skipped_bytes == splitter.skipped_bytes <= total, "skipped")

    return one
