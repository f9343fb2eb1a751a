"""Device encoders written from the ICD alone, with other libraries than the drivers use."""

import math
import struct
from dataclasses import dataclass, field

import numpy as np
from crccheck.checksum import Checksum8
from crccheck.crc import Crc32Mpeg2

GRAVITY = 9.80665
KINDS = {
    0x90: "g", 0x91: "ga", 0x92: "gi", 0x93: "gai",
    0x94: "gG", 0xA5: "gaGA", 0xA6: "giGI", 0xA7: "gaiGAI",
}  # fmt: skip
KINDS |= {0xF0 + k: clusters + "x" for k, clusters in enumerate(list(KINDS.values()))}
KINDS |= dict(zip((0x98, 0x99, 0x9A, 0x9B, 0x9C, 0xAD, 0xAE, 0xAF),
                  [KINDS[0xF0 + k] for k in range(8)], strict=True))  # fmt: skip
LENGTHS = {
    0x90: 18, 0x91: 28, 0x92: 28, 0x93: 38, 0x94: 25, 0xA5: 42, 0xA6: 42, 0xA7: 59,
    0xF0: 22, 0xF1: 32, 0xF2: 32, 0xF3: 42, 0xF4: 29, 0xF5: 46, 0xF6: 46, 0xF7: 63,
    0x98: 22, 0x99: 32, 0x9A: 32, 0x9B: 42, 0x9C: 29, 0xAD: 46, 0xAE: 46, 0xAF: 63,
}  # fmt: skip
ACC_BITS = {5: 20, 10: 19, 30: 18, 80: 16}


@dataclass
class Stim:
    """Raw integers of a STIM300 datagram; three per cluster, and a status byte each."""

    identifier: int = 0xA5
    values: dict[str, tuple[int, int, int]] = field(default_factory=dict)
    status: dict[str, int] = field(default_factory=dict)
    extra: int = 0
    counter: int = 0
    latency_us: int = 0

    def encode(self, crlf: bool = False) -> bytes:
        out = bytes([self.identifier])
        for cluster in KINDS[self.identifier]:
            status = bytes([self.status.get(cluster, 0)])
            if cluster == "x":
                out += struct.pack(">i", self.extra)[1:] + status
                continue
            width = 2 if cluster.isupper() else 3
            for number in self.values.get(cluster, (0, 0, 0)):
                out += struct.pack(">i", number)[4 - width :]
            out += status
        out += struct.pack(">BH", self.counter & 0xFF, self.latency_us)
        padded = out + b"\0" * (-len(out) % 4)
        out += Crc32Mpeg2.calcbytes(padded, byteorder="big")
        assert len(out) == LENGTHS[self.identifier]
        return out + (b"\r\n" if crlf else b"")


def mip(fields: list[tuple[int, bytes]], descriptor_set: int = 0x80) -> bytes:
    payload = b"".join(bytes([len(d) + 2, k]) + d for k, d in fields)
    packet = b"\x75\x65" + bytes([descriptor_set, len(payload)]) + payload
    sums = np.cumsum(np.frombuffer(packet, np.uint8).astype(np.int64))
    assert Checksum8.calc(packet) == sums[-1] % 256
    return packet + bytes([int(sums[-1] % 256), int(sums.sum() % 256)])


def slip(payload: bytes) -> bytes:
    body = payload + struct.pack("<I", xxh32(payload, 1425))
    return (
        b"\xc0"
        + b"".join({0xC0: b"\xdb\xdc", 0xDB: b"\xdb\xdd"}.get(b, bytes([b])) for b in body)
        + b"\xc0"
    )


def solution(
    q_wxyz, *, ticks=1, unix_us=1_000_000, valid=1, kind=0x84, identifier=24, address=0x21
):
    head = struct.pack("<4BIQ", address, kind, identifier, 0, ticks, unix_us)
    body = struct.pack("<4ff4f3B", *q_wxyz, 0.5, 0.0, 0.0, 0.0, 0.0, 3, 20, 17)
    body += struct.pack("<4ffBBBIB", 1.0, 0.0, 0.0, 0.0, 0.25, 9, 0, valid, 77, 1)
    return slip(head + body)


def xxh32(data: bytes, seed: int) -> int:
    """XXH32 from its specification (xxhash.com)."""
    p1, p2, p3, p4, p5 = 2654435761, 2246822519, 3266489917, 668265263, 374761393
    m = 0xFFFFFFFF

    def rot(x: int, r: int) -> int:
        return (x << r | x >> (32 - r)) & m

    at, n = 0, len(data)
    if n >= 16:
        lanes = [(seed + p1 + p2) & m, (seed + p2) & m, seed, (seed - p1) & m]
        while at + 16 <= n:
            for k in range(4):
                word = struct.unpack_from("<I", data, at + 4 * k)[0]
                lanes[k] = rot((lanes[k] + word * p2) & m, 13) * p1 & m
            at += 16
        acc = sum(rot(v, r) for v, r in zip(lanes, (1, 7, 12, 18), strict=True)) & m
    else:
        acc = (seed + p5) & m
    acc = (acc + n) & m
    while at + 4 <= n:
        acc = rot((acc + struct.unpack_from("<I", data, at)[0] * p3) & m, 17) * p4 & m
        at += 4
    for byte in data[at:]:
        acc = rot((acc + byte * p5) & m, 11) * p1 & m
    acc = (acc ^ acc >> 15) * p2 & m
    acc = (acc ^ acc >> 13) * p3 & m
    return acc ^ acc >> 16


def tpdo1(position_rad: float, torque_nm: float, status: int, sync: int) -> bytes:
    counts = round(position_rad / (2 * math.pi) * 2**24)
    return (
        counts.to_bytes(4, "little", signed=True)
        + round(torque_nm * 100).to_bytes(2, "little", signed=True)
        + bytes([status, sync])
    )


def tpdo1_fd(position_rad: float, torque_nm: float, status: int, sync: int) -> bytes:
    counts = round(position_rad / (2 * math.pi) * 2**24)
    return (
        counts.to_bytes(4, "little", signed=True)
        + (1234).to_bytes(4, "little", signed=True)
        + round(torque_nm * 1e4).to_bytes(4, "little", signed=True)
        + status.to_bytes(2, "little")
        + bytes([sync])
        + (-7).to_bytes(1, "little", signed=True)
        + (99).to_bytes(4, "little")
    )
