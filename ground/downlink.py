"""Splits a telemetry stream into packets, in clear or from authenticated frames.

A frame follows CCSDS 732.1-B (USLP) with the security of 355.0-B, and carries one packet:

    header 7 | SPI 2 | IV 12 | encrypted: 0xE0, packet | MAC 16 | FECF 2      [bytes, big-endian]

The IV is a number of 6 bytes that rises from frame to frame, and 6 random bytes. A frame is
accepted if its MAC is right and its number is above all received before, also by an earlier run.
"""

import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from cryptography.exceptions import InvalidTag
from fastcrc import crc16

from ground.errors import UsageError
from ground.keys import KeyFile
from ground.numbers import NumberFile
from ground.telemetry import split

HEADER_BYTES, SPI_BYTES, IV_BYTES, MAC_BYTES, FECF_BYTES = 7, 2, 12, 16, 2
DATA_AT = HEADER_BYTES + SPI_BYTES + IV_BYTES
MIN_BYTES = DATA_AT + 2 + MAC_BYTES + FECF_BYTES
USLP = 0xC << 28
EXPEDITED = 0x80  # bypass of sequence control; no OCF, no frame count
WHOLE_PACKETS = 0xE0  # construction rule 7, protocol 0
AUTHENTICATED_BITS = 0x7FE  # of the header's first word: virtual channel, MAP
SPACECRAFT_BITS = 0x0FFFF000
KEEP_S = 1.0  # between two writes of the highest IV number to the disk


class PacketStream(Protocol):
    """Splits received bytes into packets."""

    @property
    def is_authenticated(self) -> bool:
        """Whether only the daemon can have made these packets."""
        ...

    @property
    def rejected(self) -> int:
        """Number of frames that were not authentic, or repeated."""
        ...

    def add(self, data: bytes) -> None:
        """Append received bytes."""
        ...

    def packets(self) -> Iterator[bytes]:
        """Yield the complete packets. Raises LinkError if the bytes are not telemetry."""
        ...

    def close(self) -> None:
        """Store the state that the next run needs."""
        ...


class ClearStream:
    """Packets in clear, which anybody on the network can have made."""

    is_authenticated = False
    rejected = 0

    def __init__(self) -> None:
        self._buffer = bytearray()

    def add(self, data: bytes) -> None:
        """Append received bytes."""
        self._buffer += data

    def packets(self) -> Iterator[bytes]:
        """Yield the complete packets. Raises LinkError if the bytes are not telemetry."""
        return split(self._buffer)

    def close(self) -> None:
        """Do nothing: there is no state to store."""


class FrameStream:
    """Yields the packets of authenticated frames; discards and counts all other bytes.

    Parameters
    ----------
    key_file : file of 32 bytes, mode 0600; a replaced file is read again
    state_folder : folder that stores the highest IV number of each key
    names_spacecraft : whether the spacecraft is authenticated; the standard's own mask omits it
    """

    is_authenticated = True

    def __init__(
        self,
        key_file: Path,
        state_folder: Path,
        *,
        spi: int,
        spacecraft_id: int,
        virtual_channel: int,
        names_spacecraft: bool = True,
    ) -> None:
        self._key, self._folder, self._spi = KeyFile(key_file), state_folder, spi
        self._first = USLP | spacecraft_id << 12 | virtual_channel << 5
        mask = AUTHENTICATED_BITS | SPACECRAFT_BITS * names_spacecraft
        self._authenticated = (self._first & mask).to_bytes(4, "big")
        self._buffer = bytearray()
        self.rejected = 0
        self.skipped_bytes = 0
        self._following = 0  # lowest IV number that is accepted
        self._kept_s = 0.0
        self._load()

    def add(self, data: bytes) -> None:
        """Append received bytes."""
        self._buffer += data

    def packets(self) -> Iterator[bytes]:
        """Yield the packets of frames that are authentic and not repeated."""
        while len(self._buffer) >= HEADER_BYTES:
            first, length, flags = struct.unpack_from(">IHB", self._buffer)
            length += 1
            if (first, flags) != (self._first, EXPEDITED) or length < MIN_BYTES:
                self._skip()
                continue
            if len(self._buffer) < length:
                return
            frame = bytes(self._buffer[:length])
            if crc16.ibm_3740(frame) != 0:  # over a frame with its CRC
                self.rejected += 1
                self._skip()
                continue
            del self._buffer[:length]
            packet = self._open(frame)
            if packet is None:
                self.rejected += 1
            else:
                yield packet

    def close(self) -> None:
        """Store the highest IV number on the disk."""
        following = self._following
        self._numbers.change(lambda current: max(current, following))
        self._kept_s = time.monotonic()

    def _skip(self) -> None:
        """Discard bytes up to the next possible start of a frame."""
        start = self._buffer.find(self._first.to_bytes(4, "big"), 1)
        count = start if start > 0 else max(1, len(self._buffer) - 3)
        del self._buffer[:count]
        self.skipped_bytes += count

    def _open(self, frame: bytes) -> bytes | None:
        """Return the packet of a frame; None if the frame is not authentic or not new."""
        iv = frame[DATA_AT - IV_BYTES : DATA_AT]
        data = self._decrypt(frame, iv)
        if data is None and self._is_replaced():
            data = self._decrypt(frame, iv)
        number = int.from_bytes(iv, "big")
        if data is None or data[0] != WHOLE_PACKETS or number < self._following:
            return None
        self._following = number + 1
        if time.monotonic() - self._kept_s >= KEEP_S:
            self.close()
        return data[1:]

    def _decrypt(self, frame: bytes, iv: bytes) -> bytes | None:
        spi = frame[HEADER_BYTES : HEADER_BYTES + SPI_BYTES]
        if int.from_bytes(spi, "big") != self._spi:
            return None
        masked = self._authenticated + bytes(3) + spi + bytes(12)
        try:
            return self._key.cipher.decrypt(iv, frame[DATA_AT:-FECF_BYTES], masked)
        except InvalidTag:
            return None

    def _is_replaced(self) -> bool:
        """Read the key file again; return whether it holds another key than before."""
        try:
            replaced = self._key.refresh()
        except UsageError:  # the file is being replaced
            return False
        if replaced:
            self._load()
        return replaced

    def _load(self) -> None:
        self._numbers = NumberFile(self._folder / f"{self._key.fingerprint}.json")
        self._following = self._numbers.change(lambda current: current)
        self._kept_s = time.monotonic()
