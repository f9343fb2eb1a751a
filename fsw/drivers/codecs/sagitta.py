"""arcsec Sagitta star tracker: SLIP frames with an XXH32 check, little-endian.

`C0 | escaped(payload | XXH32(payload, seed 1425)) | C0`; the payload begins with the address byte.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from xxhash import xxh32_intdigest

from fsw.drivers.codecs.attitude_datagram import AttitudeDatagram, StarTrackerCodec
from fsw.drivers.codecs.framing import Framer
from fsw.drivers.wire import Reject

ADDRESS = 0x21
SET_PARAMETER = 0x00
ASYNCHRONOUS_TELEMETRY = 0x84
TELEMETRY_REPLY = 0x82
SOLUTION_ID = 24
PARAMETER_SUBSCRIPTION = 18
SUBSCRIPTION_SLOTS = 16
HASH_SEED = 1425
MAX_FRAME_BYTES = 1024
NORM_TOLERANCE = 1e-3

_END, _ESCAPE, _ESCAPED_END, _ESCAPED_ESCAPE = 0xC0, 0xDB, 0xDC, 0xDD
_HEADER = struct.Struct("<BBBBIQ")
# attitude, confidence, tracking q, 3 counts, lost-in-space q, f32, u8, mode, valid, count, strategy
_SOLUTION = struct.Struct("<4f f 4f 3B 4f f B B B I B")
_CHECKED_BYTES = _HEADER.size + _SOLUTION.size + 4  # of a solution between delimiters, unescaped
DEVICES: Mapping[str, Mapping[str, Any]] = {
    "sagitta": {
        "title": "arcsec Sagitta",
        "source": "data sheet from memory (2 arcsec across, 10 arcsec about the boresight); "
        "latency not known, measure it",
        "verified": False,
        "rate_hz": 5.0,
        "baud_rate": 115200,
        "latency_s": 0.1,
        "noise_across_rad": 9.7e-6,
        "noise_about_rad": 4.85e-5,
    }
}


@dataclass(frozen=True, slots=True)
class Telemetry:
    """Header of a frame from the unit, and its payload without header and hash."""

    kind: int
    identifier: int
    status: int
    ticks: int
    unix_us: int
    body: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution(AttitudeDatagram):
    """Attitude solution as the unit gives it: quaternions w x y z, inertial to tracker."""

    status: int
    ticks: int
    confidence: float  # lower is better
    q_tracking_wxyz: tuple[float, float, float, float]
    stars_removed: int
    stars_centroided: int
    stars_matched: int
    q_lost_in_space_wxyz: tuple[float, float, float, float]
    lost_in_space_quality: float
    lost_in_space_stars: int
    mode: int  # 1 lost-in-space, 0 tracking
    valid: bool
    stable_count: int
    strategy: int


def encode(payload: bytes) -> bytes:
    """Return the SLIP frame of a payload with its hash."""
    body = payload + xxh32_intdigest(payload, HASH_SEED).to_bytes(4, "little")
    body = body.replace(b"\xdb", b"\xdb\xdd").replace(b"\xc0", b"\xdb\xdc")
    return b"\xc0" + body + b"\xc0"


def encode_subscribe(identifiers: tuple[int, ...]) -> bytes:
    """Return the command that makes the unit send up to 16 kinds of telemetry unasked."""
    if len(identifiers) > SUBSCRIPTION_SLOTS:
        raise ValueError(f"{len(identifiers)} subscriptions; at most {SUBSCRIPTION_SLOTS}")
    slots = bytes(identifiers).ljust(SUBSCRIPTION_SLOTS, b"\0")
    return encode(bytes((ADDRESS, SET_PARAMETER, PARAMETER_SUBSCRIPTION)) + slots)


def unescape(body: bytes) -> bytes | None:
    """Return the bytes without SLIP escapes; None if an escape is invalid."""
    if _ESCAPE not in body:
        return body
    parts = body.split(b"\xdb")
    out = bytearray(parts[0])
    for part in parts[1:]:
        if not part or part[0] not in (_ESCAPED_END, _ESCAPED_ESCAPE):
            return None
        out.append(_END if part[0] == _ESCAPED_END else _ESCAPE)
        out += part[1:]
    return bytes(out)


def decode_payload(frame: bytes) -> bytes | Reject:
    """Check the hash of a SLIP frame (with delimiters); return the payload without the hash."""
    body = unescape(frame[1:-1])
    if body is None:
        return Reject.SYNC
    if len(body) < 5:
        return Reject.LENGTH
    if xxh32_intdigest(body[:-4], HASH_SEED) != int.from_bytes(body[-4:], "little"):
        return Reject.CRC
    return body[:-4]


def decode_telemetry(payload: bytes) -> Telemetry | Reject:
    """Decode the header of a frame from the unit."""
    if payload[0] != ADDRESS:
        return Reject.NODE
    if len(payload) < _HEADER.size:
        return Reject.LENGTH
    _, kind, identifier, status, ticks, unix_us = _HEADER.unpack_from(payload)
    return Telemetry(kind, identifier, status, ticks, unix_us, payload[_HEADER.size :])


def decode_solution(telemetry: Telemetry) -> Solution | Reject:
    """Decode a solution; reject one that is flagged invalid or has no unit quaternion."""
    if len(telemetry.body) != _SOLUTION.size:
        return Reject.LENGTH
    f = _SOLUTION.unpack(telemetry.body)
    q = (f[0], f[1], f[2], f[3])
    solution = Solution(
        status=telemetry.status,
        ticks=telemetry.ticks,
        unix_us=telemetry.unix_us,
        q_wxyz=q,
        confidence=f[4],
        q_tracking_wxyz=(f[5], f[6], f[7], f[8]),
        stars_removed=f[9],
        stars_centroided=f[10],
        stars_matched=f[11],
        q_lost_in_space_wxyz=(f[12], f[13], f[14], f[15]),
        lost_in_space_quality=f[16],
        lost_in_space_stars=f[17],
        mode=f[18],
        valid=f[19] == 1,
        stable_count=f[20],
        strategy=f[21],
    )
    if not solution.valid:
        return Reject.STATUS
    norm = math.sqrt(sum(x * x for x in q))
    if not abs(norm - 1.0) <= NORM_TOLERANCE:  # NaN is out of range too
        return Reject.RANGE
    return solution


class SlipMatcher:
    """Finds frames with a correct hash between delimiters."""

    def search(self, data: bytearray, start: int) -> int:
        """Return the place of the next delimiter, else len(data)."""
        at = data.find(_END, start)
        return len(data) if at < 0 else at

    def match(self, data: bytearray, start: int) -> int:
        """Return the length of the frame at `start`; 0 if it is incomplete, -1 if none."""
        end = data.find(_END, start + 1)
        if end < 0:
            return 0 if len(data) - start < MAX_FRAME_BYTES else -1
        if end - start < 6 or end - start > MAX_FRAME_BYTES:
            return -1
        payload = decode_payload(bytes(data[start : end + 1]))
        return -1 if isinstance(payload, Reject) else end + 1 - start


class SagittaCodec(StarTrackerCodec):
    """Stream codec: `framer` finds frames, `decode` gives a `Solution` or other telemetry."""

    title = "arcsec Sagitta"
    devices = DEVICES
    frame_bytes = (2 + _CHECKED_BYTES, 2 + 2 * _CHECKED_BYTES)  # without escapes; all are escaped

    def __init__(self) -> None:
        self.framer = Framer(SlipMatcher())

    def start(self) -> bytes:
        """Return the subscription to solutions."""
        return encode_subscribe((SOLUTION_ID,))

    def decode(self, frame: bytes) -> Solution | Telemetry | Reject:
        """Decode a frame that the framer has checked; only solutions are decoded in full."""
        payload = decode_payload(frame)
        if isinstance(payload, Reject):
            return payload
        if payload[0] == ADDRESS and len(payload) < _HEADER.size:
            padded = payload[:4].ljust(4, b"\0")
            return Telemetry(padded[1], padded[2], padded[3], 0, 0, b"")
        telemetry = decode_telemetry(payload)
        if isinstance(telemetry, Reject):
            return telemetry
        if telemetry.identifier == SOLUTION_ID and telemetry.kind in (
            ASYNCHRONOUS_TELEMETRY,
            TELEMETRY_REPLY,
        ):
            return decode_solution(telemetry)
        return telemetry
