"""The sending end of authenticated telecommands: CCSDS 355.0-B on TC frames of 232.0-B.

An IV is the next number of the key (6 bytes) and 6 random bytes. The number is stored as used
before the frame is made. If the stored number is lost (another state folder, an old copy of it),
the random bytes prevent that the key seals two frames with one IV.
"""

import secrets
import struct
from pathlib import Path

from fastcrc import crc16

from ground.errors import UsageError
from ground.keys import KeyFile
from ground.numbers import NumberFile

OVERHEAD_BYTES = 5 + 2 + 12 + 16 + 2  # header, SPI, IV, MAC, frame error control
MAX_FRAME_BYTES = 1024
HALF_IV_BYTES = 6
MAX_NUMBER = (1 << 8 * HALF_IV_BYTES) - 1
BYPASS = 1 << 13


class Sealer:
    """Seals (encrypts and authenticates) packets with the key in a file.

    Parameters
    ----------
    key_file : file of 32 bytes, mode 0600; a replaced file is read again
    state_folder : folder that stores the next number of each key
    names_spacecraft : whether the spacecraft is authenticated; the standard's own mask omits it
    """

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
        self._key, self._folder = KeyFile(key_file), state_folder
        self._spi, self._first, self._channel = spi, BYPASS | spacecraft_id, virtual_channel
        self._named = (spacecraft_id * names_spacecraft).to_bytes(2, "big")

    def seal(self, packet: bytes) -> bytes:
        """Return the sealed frame of one packet, with the next number. Raises UsageError."""
        length = OVERHEAD_BYTES + len(packet)
        if length > MAX_FRAME_BYTES:
            most = MAX_FRAME_BYTES - OVERHEAD_BYTES
            raise UsageError(f"{len(packet)} bytes; a frame carries at most {most}")
        self._key.refresh()
        number = self._numbers.change(lambda current: current + 1)
        iv = number.to_bytes(HALF_IV_BYTES, "big") + secrets.token_bytes(HALF_IV_BYTES)
        header = struct.pack(">HHB", self._first, self._channel << 10 | length - 1, 0)
        spi = self._spi.to_bytes(2, "big")
        masked = self._named + bytes((header[2] & 0xFC, 0, 0)) + spi + bytes(12)
        frame = header + spi + iv + self._key.cipher.encrypt(iv, packet, masked)
        return frame + crc16.ibm_3740(frame).to_bytes(2, "big")

    @property
    def is_new(self) -> bool:
        """Whether the state folder has no number of this key yet."""
        return self._numbers.is_new

    @property
    def next_number(self) -> int:
        """The number of the next frame; 0 for a new key."""
        return 0 if self.is_new else self._numbers.change(lambda current: current)

    def set_next(self, number: int) -> None:
        """Set the number of the next frame, higher or lower. Raises UsageError."""
        if not 0 <= number <= MAX_NUMBER:
            raise UsageError(f"number {number}; must be 0 to {MAX_NUMBER}")
        self._numbers.change(lambda _current: number)

    @property
    def _numbers(self) -> NumberFile:
        return NumberFile(self._folder / f"{self._key.fingerprint}.json")
