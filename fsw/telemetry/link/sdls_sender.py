"""Authenticated telemetry: one packet per CCSDS 732.1-B frame (USLP), secured by 355.0-B (SDLS).

    header 7 | SPI 2 | IV 12 | encrypted: TFDF header 1, packet | MAC 16 | FECF 2

Frames have variable length and no insert zone, frame count or OCF. Their data field begins with
construction rule 7 (whole packets). The cipher is AES-256-GCM. The IV is a number of 6 bytes, which
rises from frame to frame even after a crash, and 6 random bytes. The additional authenticated data
are header and security header under a mask: spacecraft (left out by the standard's own mask),
virtual channel, MAP, SPI.
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
# of the header's first four bytes; CCSDS 355.0-B-2, mask of USLP frames: VCID, MAP ID (and SPI)
AUTHENTICATED, SPACECRAFT = 0x7FE, 0x0FFFF000
AHEAD = 1 << 16  # numbers stored ahead: one write per 65536 frames
RETRY = 1 << 8  # frames after which a failed write is repeated
EPOCH_S = 946_684_800  # 2000-01-01T00:00:00Z: origin of the numbers that follow from the time
PER_SECOND = 1 << 16  # numbers for each second of time: more than the frames that can be sent
MAX_SECONDS = (1 << 31) - 1  # until 2068; a wrong clock leaves half of all numbers
OVERHEAD_BYTES = HEADER_BYTES + SPI_BYTES + IV_BYTES + 1 + MAC_BYTES + FECF_BYTES
Report = Callable[[str, str], None]  # event code, text


def least_number(unix_s: float) -> int:
    """Return the least first number of a run: above those of all runs that began before."""
    return min(max(0, int(unix_s) - EPOCH_S), MAX_SECONDS) * PER_SECOND


class FrameSender:
    """Encrypts and authenticates telemetry packets.

    The first number is the larger of the stored one and the one that follows from the time of day.
    So numbers rise over a restart also if they could not be stored, or if the clock went back.

    Parameters
    ----------
    numbers : stored IVs; if they cannot be stored, telemetry continues and an event reports that
    unix_s : returns the time of day [s]
    names_spacecraft : whether the spacecraft is authenticated; the standard's own mask omits it
    """

    def __init__(
        self,
        association: Association,
        numbers: FrameNumbers,
        *,
        spacecraft_id: int,
        virtual_channel: int,
        report: Report,
        unix_s: Callable[[], float],
        names_spacecraft: bool = True,
    ) -> None:
        self._numbers, self._report, self._unix_s = numbers, report, unix_s
        self._spacecraft, self._channel = spacecraft_id, virtual_channel
        self._mask = AUTHENTICATED | SPACECRAFT * names_spacecraft
        self._following: dict[str, int] = {}  # next number by key; not below the stored one
        self._has_failed = False
        self.use(association)

    def use(self, association: Association) -> None:
        """Use this key for all frames from now on."""
        self._association, self._cipher = association, AESGCM(association.key)
        name = association.fingerprint
        stored = -(-self._numbers.floor(name) >> RANDOM_BITS)
        used = self._following.get(name, 0)
        self._following[name] = max(stored, used, least_number(self._unix_s()))
        self._kept = self._following[name]  # numbers below this one are stored as used

    def seal(self, packet: bytes) -> bytes:
        """Return the frame of one packet."""
        header = self._header(OVERHEAD_BYTES + len(packet))
        iv = self._next_number().to_bytes(6, "big") + secrets.token_bytes(6)
        spi = self._association.spi.to_bytes(SPI_BYTES, "big")
        first = int.from_bytes(header[:4], "big") & self._mask
        masked = first.to_bytes(4, "big") + bytes(3) + spi + bytes(IV_BYTES)
        sealed = self._cipher.encrypt(iv, bytes((WHOLE_PACKETS,)) + packet, masked)
        frame = header + spi + iv + sealed
        return frame + fastcrc.crc16.ibm_3740(frame).to_bytes(FECF_BYTES, "big")

    def settle(self) -> None:
        """Store the exact next number, so that the next start skips none. Raises OSError."""
        name = self._association.fingerprint
        self._numbers.settle({name: self._following[name] << RANDOM_BITS})
        self._kept = self._following[name]

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
        name = self._association.fingerprint
        number = self._following[name]
        self._following[name] = number + 1
        if number >= self._kept:
            self._keep(name, number)
        return number

    def _keep(self, name: str, number: int) -> None:
        """Store numbers ahead; repeat a failed write later, and report the first failure."""
        used, ahead = number << RANDOM_BITS, number + AHEAD
        try:
            self._numbers.claim(name, used, ahead << RANDOM_BITS)
        except OSError as error:
            self._kept = number + RETRY
            if not self._has_failed:
                self._report("TM_NUMBERS_FAILED", error.strerror or str(error))
            self._has_failed = True
        else:
            self._kept, self._has_failed = ahead, False
