"""Datagrams of a live feed, packed or as JSON, behind which a keyed feed has a check value.

`docs/howto/feed.md` describes every byte.
"""

import hmac
import json
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from operator import index
from typing import Any

from fsw.drivers.wire import Reject
from fsw.errors import WRONG_CONTENT

MAGIC = b"FSW1"
MOST_BYTES = 1400  # fits one frame of Ethernet
TAG_BYTES = 16
MOST_VALUES = 64
CLOCKS = ("monotonic", "unix", "tai", "device")  # number on the wire: place in this list
_HEAD = struct.Struct("<4sIIBBHQqq")
_KNOWN = (1 << MOST_VALUES) - 1


class Kind(IntEnum):
    """What the values of a datagram are."""

    JOINTS = 1  # positions of all joints, torques of all, then speeds of all or none
    IMU = 2  # angular rate x y z, specific force x y z
    ATTITUDE = 3  # quaternion x y z w


@dataclass(frozen=True, slots=True)
class Datagram:
    """One datagram; times are of the sender's clock."""

    source: int
    sequence: int
    kind: Kind
    clock: str
    t_valid_ns: int
    t_sent_ns: int
    values: tuple[float, ...]  # SI; NaN: not valid


def decode_datagram(data: bytes, key: bytes | None = None) -> Datagram | Reject:
    """Return the content of a datagram, or the reason why it is refused.

    With a key the check value is judged before anything else is read.
    """
    if len(data) > MOST_BYTES:
        return Reject.LENGTH
    if key is not None:
        data, tag = data[:-TAG_BYTES], data[-TAG_BYTES:]
        if not hmac.compare_digest(hmac.digest(key, data, "sha256")[:TAG_BYTES], tag):
            return Reject.CRC
    try:
        return _from_json(json.loads(data)) if data[:1] == b"{" else _unpacked(data)
    except WRONG_CONTENT:
        return Reject.LENGTH


def _unpacked(data: bytes) -> Datagram | Reject:
    if data[:4] != MAGIC:
        return Reject.SYNC
    if len(data) < _HEAD.size:
        return Reject.LENGTH
    _, source, sequence, kind, clock, count, mask, t_valid_ns, t_sent_ns = _HEAD.unpack_from(data)
    if count > MOST_VALUES or len(data) != _HEAD.size + 8 * count:
        return Reject.LENGTH
    values = struct.unpack_from(f"<{count}d", data, _HEAD.size)
    numbers = source, sequence, t_valid_ns, t_sent_ns
    return _datagram(numbers, Kind(kind), CLOCKS[clock], mask, values)


def _from_json(message: dict[str, Any]) -> Datagram | Reject:
    names = ("source", "sequence", "t_valid_ns", "t_sent_ns")
    source, sequence, t_valid_ns, t_sent_ns = (index(message[name]) for name in names)
    given = [math.nan if value is None else value for value in message["values"]]
    if len(given) > MOST_VALUES or any(isinstance(value, str) for value in given):
        return Reject.LENGTH
    kind, mask = Kind[message["kind"].upper()], index(message.get("mask", _KNOWN))
    clock = CLOCKS[CLOCKS.index(message["clock"])]
    values = [float(value) for value in given]
    return _datagram((source, sequence, t_valid_ns, t_sent_ns), kind, clock, mask, values)


def _datagram(
    numbers: tuple[int, int, int, int], kind: Kind, clock: str, mask: int, values: Sequence[float]
) -> Datagram | Reject:
    """Return a datagram with NaN in place of values that are masked or not finite."""
    source, sequence, t_valid_ns, t_sent_ns = numbers
    if source >> 32 or sequence >> 32 or t_valid_ns >> 63 or t_sent_ns >> 63:
        return Reject.LENGTH
    usable = tuple(
        value if mask >> place & 1 and math.isfinite(value) else math.nan
        for place, value in enumerate(values)
    )
    return Datagram(source, sequence, kind, clock, t_valid_ns, t_sent_ns, usable)
