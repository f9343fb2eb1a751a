"""A sender of authenticated TC frames written from CCSDS 232.0-B and 355.0-B, not from the daemon.

Fields of the primary header (232.0-B 4.1.2): version 2 bits, bypass 1, control command 1, spare 2,
spacecraft 10, virtual channel 6, length - 1 10, sequence number 8. Mask (355.0-B, TC): VCID, SPI,
and, unless `standard_mask`, the spacecraft.
"""

import binascii
from dataclasses import dataclass

from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes


def bits(*fields: tuple[int, int]) -> bytes:
    """Return (value, width) fields packed from the most significant bit on."""
    text = "".join(f"{value:0{width}b}" for value, width in fields)
    return int(text, 2).to_bytes(len(text) // 8, "big")


def with_fecf(body: bytes) -> bytes:
    """Append CRC-16 (polynomial 0x1021, preset to ones)."""
    return body + binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "big")


@dataclass(kw_only=True)
class Sender:
    """One security association of the sending end; every header field may be spoiled."""

    key: bytes
    spi: int = 7
    spacecraft_id: int = 42
    virtual_channel: int = 3
    version: int = 0
    bypass: int = 1
    control: int = 0
    spare: int = 0
    sequence: int = 0
    standard_mask: bool = False

    def frame(self, packet: bytes, number: int, random: int = 0) -> bytes:
        length = 5 + 2 + 12 + len(packet) + 16 + 2
        header = bits(
            (self.version, 2),
            (self.bypass, 1),
            (self.control, 1),
            (self.spare, 2),
            (self.spacecraft_id, 10),
            (self.virtual_channel, 6),
            (length - 1, 10),
            (self.sequence, 8),
        )
        iv = bits((number, 48), (random, 48))
        named = 0 if self.standard_mask else self.spacecraft_id
        masked = bits((0, 6), (named, 10), (self.virtual_channel, 6), (0, 18))
        seal = Cipher(algorithms.AES(self.key), modes.GCM(iv)).encryptor()
        seal.authenticate_additional_data(masked + self.spi.to_bytes(2, "big") + bytes(12))
        sealed = seal.update(packet) + seal.finalize()
        return with_fecf(header + self.spi.to_bytes(2, "big") + iv + sealed + seal.tag)
