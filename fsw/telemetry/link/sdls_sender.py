"""Authenticated telemetry: one packet per CCSDS 732.1-B frame (USLP), secured by 355.0-B (SDLS).

    header 7 | SPI 2 | IV 12 | encrypted: TFDF header 1, packet | MAC 16 | FECF 2

Frames have variable length and no insert zone, frame count or OCF. Their data field begins with
construction rule 7 (whole packets). The cipher is AES-256-GCM. The IV is a number of 6 bytes, which
rises from frame to frame even after a crash, and 6 random bytes. The additional authenticated data
are header and security header under the standard's mask: virtual channel, MAP, SPI.
"""

import secrets
from collections.abc import Callable

import fastcrc
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from spacepackets.uslp.header import (
    BypassSequenceControlFlag,
    PrimaryHeader,
    SourceOrDestField,
)

from fsw.telemetry.link.sdls import (
    FECF_BYTES,
    IV_BYTES,
    MAC_BYTES,
    RANDOM_BITS,
    SPI_BYTES,
    Association,
    FrameNumbers,
)

HEADER_BYTES = 7
WHOLE_PACKETS = 0xE0  # construction rule 7, protocol 0: space packets
AHEAD = 1 << 16  # numbers stored ahead: one write per 65536 frames
OVERHEAD_BYTES = HEADER_BYTES + SPI_BYTES + IV_BYTES + 1 + MAC_BYTES + FECF_BYTES
Report = Callable[[str, str], None]  # event code, text


class FrameSender:
    """Encrypts and authenticates telemetry packets.

    Parameters
    ----------
    numbers : stored IVs; if they cannot be stored, telemetry continues and an event reports that
    """

    def __init__(
        self,
        association: Association,
        numbers: FrameNumbers,
        *,
        spacecraft_id: int,
        virtual_channel: int,
        report: Report,
    ) -> None:
        self._numbers, self._report = numbers, report
        self._spacecraft, self._channel = spacecraft_id, virtual_channel
        self.use(association)

    def use(self, association: Association) -> None:
        """Use this key for all frames from now on."""
        self._association, self._cipher = association, AESGCM(association.key)
        self._number = -(-self._numbers.floor(association.fingerprint) >> RANDOM_BITS)
        self._kept = self._number  # numbers below this one are stored as used

    def seal(self, packet: bytes) -> bytes:
        """Return the frame of one packet."""
        header = self._header(OVERHEAD_BYTES + len(packet))
        iv = self._next_number().to_bytes(6, "big") + secrets.token_bytes(6)
        spi = self._association.spi.to_bytes(SPI_BYTES, "big")
        sealed = self._cipher.encrypt(iv, bytes((WHOLE_PACKETS,)) + packet, _masked(header, spi))
        frame = header + spi + iv + sealed
        return frame + fastcrc.crc16.ibm_3740(frame).to_bytes(FECF_BYTES, "big")

    def settle(self) -> None:
        """Store the exact next number, so that the next start skips none. Raises OSError."""
        self._numbers.settle({self._association.fingerprint: self._number << RANDOM_BITS})
        self._kept = self._number

    def _header(self, size: int) -> bytes:
        header = PrimaryHeader(
            scid=self._spacecraft,
            src_dest=SourceOrDestField.SOURCE,
            vcid=self._channel,
            map_id=0,
            frame_len=size - 1,
            bypass_seq_ctrl_flag=BypassSequenceControlFlag.EXPEDITED_QOS,
        )
        return bytes(header.pack())

    def _next_number(self) -> int:
        """Return the next number and count it as used."""
        number, self._number = self._number, self._number + 1
        if number >= self._kept:
            self._kept = number + AHEAD  # a failed write is repeated at that number
            used, kept = number << RANDOM_BITS, self._kept << RANDOM_BITS
            try:
                self._numbers.claim(self._association.fingerprint, used, kept)
            except OSError as error:
                self._report("TM_NUMBERS_FAILED", error.strerror or str(error))
        return number


def _masked(header: bytes, spi: bytes) -> bytes:
    """Return the additional authenticated data of a frame.

    Source: CCSDS 355.0-B-2, authentication bit mask of USLP frames: VCID, MAP ID and SPI.
    """
    return bytes((0, 0, header[2] & 0x07, header[3] & 0xFE, 0, 0, 0)) + spi + bytes(IV_BYTES)
