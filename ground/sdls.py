"""The sending end of authenticated telecommands: CCSDS 355.0-B on TC frames of 232.0-B.

The same key never seals two frames with one number, whatever happens to this process: a number is
written down as used before it is.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import struct
from collections.abc import Callable
from pathlib import Path

from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from fastcrc import crc16

from ground.errors import UsageError

OVERHEAD_BYTES = 5 + 2 + 12 + 16 + 2  # header, SPI, IV, MAC, frame error control
MAX_FRAME_BYTES = 1024
KEY_BYTES = 32
BYPASS = 1 << 13


class Sealer:
    """Seals packets with one key.

    Parameters
    ----------
    key_file : 32 bytes, closed to others
    state_folder : where the next number of each key is kept
    """

    def __init__(
        self,
        key_file: Path,
        state_folder: Path,
        *,
        spi: int,
        spacecraft_id: int,
        virtual_channel: int,
    ) -> None:
        try:
            key = key_file.read_bytes()
        except OSError as error:
            raise UsageError(f"{key_file}: {error.strerror}") from error
        if len(key) != KEY_BYTES or key_file.stat().st_mode & 0o077:
            raise UsageError(f"{key_file}: must hold {KEY_BYTES} bytes and have mode 0600")
        self._cipher = AESGCM(key)
        state_folder.mkdir(parents=True, exist_ok=True)
        self._state = state_folder / f"{hashlib.sha256(key).hexdigest()[:16]}.json"
        self._spi, self._first, self._channel = spi, BYPASS | spacecraft_id, virtual_channel

    def seal(self, packet: bytes) -> bytes:
        """Return the frame of one packet, under the next number."""
        length = OVERHEAD_BYTES + len(packet)
        if length > MAX_FRAME_BYTES:
            most = MAX_FRAME_BYTES - OVERHEAD_BYTES
            raise UsageError(f"{len(packet)} bytes; a frame carries at most {most}")
        iv = self._take_number().to_bytes(12, "big")
        header = struct.pack(">HHB", self._first, self._channel << 10 | length - 1, 0)
        spi = self._spi.to_bytes(2, "big")
        masked = bytes((0, 0, header[2] & 0xFC, 0, 0)) + spi + bytes(12)
        frame = header + spi + iv + self._cipher.encrypt(iv, packet, masked)
        return frame + crc16.ibm_3740(frame).to_bytes(2, "big")

    def is_behind(self, number: int) -> bool:
        """Whether the next number is below this one."""
        return self._change(lambda current: current) < number

    def skip_to(self, number: int) -> None:
        """Use no number below this one; what the daemon says it takes next."""
        self._change(lambda current: max(current, number))

    def _take_number(self) -> int:
        return self._change(lambda current: current + 1)

    def _change(self, step: Callable[[int], int]) -> int:
        """Move the next number on; return what it was. Several programs may do so at once."""
        with self._state.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            current = (
                int(json.loads(self._state.read_text())["next"]) if self._state.exists() else 0
            )
            temporary = self._state.with_suffix(".new")
            with temporary.open("w") as new:
                json.dump({"next": step(current)}, new)
                new.flush()
                os.fsync(new.fileno())
            temporary.replace(self._state)
        return current
