"""Sagitta star tracker: SLIP frames with XXH32, requests and answers.

Source: the project's ICD (arcsec Sagitta). Little-endian. Answers to requests other than the
solution have four bytes (address, type, id, status); no document confirms this.
"""

import struct
from dataclasses import dataclass

import xxhash

ADDRESS = 0x21
HASH_SEED = 1425
SOLUTION_ID = 24
SUBSCRIPTION_ID = 18
SET_PARAMETER, GET_PARAMETER, REQUEST_TELEMETRY, ACTION = 0x00, 0x01, 0x02, 0x03
ASYNCHRONOUS = 0x84
STATUS_OK, STATUS_UNKNOWN = 0x00, 0x01
END, ESC, ESC_END, ESC_ESC = 0xC0, 0xDB, 0xDC, 0xDD
SOLUTION_BYTES = 89  # on the wire, before escaping


def frame(payload: bytes) -> bytes:
    """Return the frame of a payload: append the hash, escape, and delimit."""
    body = payload + xxhash.xxh32_intdigest(payload, HASH_SEED).to_bytes(4, "little")
    body = body.replace(b"\xdb", b"\xdb\xdd").replace(b"\xc0", b"\xdb\xdc")
    return b"\xc0" + body + b"\xc0"


def unframe(body: bytes) -> bytes | None:
    """Return the payload of the bytes between two delimiters; None if the hash is wrong."""
    raw = body.replace(b"\xdb\xdc", b"\xc0").replace(b"\xdb\xdd", b"\xdb")
    if len(raw) < 7:
        return None
    payload, tail = raw[:-4], raw[-4:]
    good = xxhash.xxh32_intdigest(payload, HASH_SEED).to_bytes(4, "little") == tail
    return payload if good else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """One attitude solution as the unit reports it."""

    q_wxyz: tuple[float, float, float, float]
    unix_us: int
    ticks: int
    confidence: float = 0.1
    matched_count: int = 20
    mode: int = 1
    valid: bool = True
    stable_count: int = 0
    strategy: int = 0


def solution_payload(solution: Solution, *, message_type: int = ASYNCHRONOUS) -> bytes:
    """Return the 83 unescaped bytes before the hash."""
    q = struct.pack("<4f", *solution.q_wxyz)
    matched = solution.matched_count
    return b"".join(
        (
            struct.pack("<4BIQ", ADDRESS, message_type, SOLUTION_ID, STATUS_OK, *_stamp(solution)),
            q,
            struct.pack("<f", solution.confidence),
            q,
            struct.pack("<3B", 0, min(255, matched + 5), matched),
            q,
            struct.pack("<fB", solution.confidence, matched),
            struct.pack("<BB", solution.mode, solution.valid),
            struct.pack("<IB", solution.stable_count & 0xFFFFFFFF, solution.strategy),
        )
    )


def _stamp(solution: Solution) -> tuple[int, int]:
    return solution.ticks & 0xFFFFFFFF, solution.unix_us


class RequestReader:
    """Splits bytes of the host into payloads, with a bounded buffer."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Return every payload that is now complete."""
        parts = (self._buffer + data).split(bytes([END]))
        self._buffer = parts.pop()[-512:]
        payloads = (unframe(part) for part in parts if part)
        return [payload for payload in payloads if payload is not None]


def subscription_of(payload: bytes) -> frozenset[int] | None:
    """Return the telemetry ids to which a request subscribes; None for other requests."""
    if payload[:3] != bytes([ADDRESS, SET_PARAMETER, SUBSCRIPTION_ID]):
        return None
    return frozenset(payload[3:]) - {0}


def answer(payload: bytes) -> bytes | None:
    """Return the framed four-byte answer to a request to this unit; None for other payloads."""
    if len(payload) < 3 or payload[0] != ADDRESS or payload[1] > ACTION:
        return None
    known = payload[1] in (SET_PARAMETER, ACTION) or payload[2] == SOLUTION_ID
    status = STATUS_OK if known else STATUS_UNKNOWN
    return frame(bytes([ADDRESS, 0x80 | payload[1], payload[2], status]))
