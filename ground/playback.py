"""Playback of missed telemetry: finds the time ranges that a stored stream lacks, requests them.

A stream is a file of `ground tm --raw`: packets one after the other. Gaps in the sequence counts
show that packets are missing; the times in the packets give the range. A retrieved packet has the
same bytes as when it was first sent, so packets that are already in the file are left out.
"""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path

from ground.commands import Catalogue
from ground.errors import LinkError, UsageError
from ground.link import Link
from ground.telemetry import FRACTIONS_PER_S, HEADER_BYTES, TelemetryDecoder, apid, split
from ground.verification import Verification

COMMAND = "PLAY_BACK"
STORES = ("EVENTS", "HOUSEKEEPING", "SCIENCE")
STORES_OF = {100: ("EVENTS", "HOUSEKEEPING"), 102: ("SCIENCE",)}  # by APID
COUNT_14 = 1 << 14
P_FIELD = 0x2F
TIME_AT = HEADER_BYTES + 7  # of the P-field in a packet with a secondary header
LAST_S = float((1 << 32) - 1)  # latest time that a packet can hold: stands for now
MOST_RANGES = 32  # most ranges of a store; more are requested as one
SECONDARY_HEADER = 0x08
VERIFICATION = 1  # service


@dataclass(frozen=True, slots=True, order=True)
class Range:
    """A range of mission elapsed times [s], both ends included."""

    from_s: float
    to_s: float


def time_of(packet: bytes) -> float | None:
    """Return the mission elapsed time in a packet's secondary header [s]; None if it has none."""
    if not packet[0] & SECONDARY_HEADER or len(packet) < TIME_AT + 8 or packet[TIME_AT] != P_FIELD:
        return None
    coarse = int.from_bytes(packet[TIME_AT + 1 : TIME_AT + 5], "big")
    fine = int.from_bytes(packet[TIME_AT + 5 : TIME_AT + 8], "big")
    return coarse + fine / FRACTIONS_PER_S


def missing_ranges(packets: Iterable[bytes]) -> dict[str, list[Range]]:
    """Return the missing ranges by packet store: gaps in sequence counts, and from the end to now.

    If the stream has no packets of an APID, the range of its stores is all time.
    """
    timed = [(apid(packet), t_s, packet) for packet in packets if (t_s := time_of(packet))]
    timed.sort(key=lambda item: item[:2])
    by_apid = {key: list(items) for key, items in groupby(timed, key=lambda item: item[0])}
    found: dict[str, list[Range]] = {}
    for number, stores in STORES_OF.items():
        items = by_apid.get(number, [])
        ranges = [
            Range(before_s, after_s)
            for (_, before_s, before), (_, after_s, after) in pairwise(items)
            if (_count(after) - _count(before)) % COUNT_14 not in (0, 1)
        ]
        ranges.append(Range(items[-1][1] if items else 0.0, LAST_S))
        found |= {store: merged(ranges) for store in stores}
    return found


def merged(ranges: Sequence[Range]) -> list[Range]:
    """Return the ranges in order without overlap; one range around all if there are too many."""
    joined: list[Range] = []
    for item in sorted(ranges):
        if joined and item.from_s <= joined[-1].to_s:
            joined[-1] = Range(joined[-1].from_s, max(joined[-1].to_s, item.to_s))
        else:
            joined.append(item)
    if len(joined) > MOST_RANGES:
        return [Range(joined[0].from_s, joined[-1].to_s)]
    return joined


def read_stream(path: Path) -> list[bytes]:
    """Return the packets of a stored stream. Raises UsageError."""
    try:
        return list(split(bytearray(path.read_bytes())))
    except (OSError, LinkError) as error:
        raise UsageError(f"{path}: {error}") from error


def retrieve(
    link: Link,
    catalogue: Catalogue,
    decoder: TelemetryDecoder,
    store: str,
    wanted: Range,
    timeout_s: float,
) -> tuple[Verification, list[bytes]]:
    """Request the packets of a store and time range; return verification and received packets.

    Packets that are sent for the first time meanwhile are included if they are in the range.
    Raises LinkError.
    """
    packet = catalogue.build(COMMAND, _arguments(store, wanted), link.next_sequence())
    words = int.from_bytes(packet[:2], "big"), int.from_bytes(packet[2:4], "big")
    is_authenticated = link.stream.is_authenticated
    verification = Verification(request=words, is_authenticated=is_authenticated)
    found: list[bytes] = []
    link.send(packet)
    for raw in link.packets(time.monotonic() + timeout_s):
        t_s = time_of(raw)
        if t_s is None:
            continue
        if raw[HEADER_BYTES + 1] == VERIFICATION:
            verification.take(decoder.decode(raw))
        elif wanted.from_s <= t_s <= wanted.to_s:
            found.append(raw)
        if verification.over:
            break
    return verification, found


def _arguments(store: str, wanted: Range) -> dict[str, str]:
    given = {"store": store}
    for name, value_s in (("from", wanted.from_s), ("to", wanted.to_s)):
        coarse, fine = divmod(round(value_s * FRACTIONS_PER_S), FRACTIONS_PER_S)
        given |= {f"{name}_p_field": str(P_FIELD)}
        given |= {f"{name}_coarse_s": str(coarse), f"{name}_fine": str(fine)}
    return given


def _count(packet: bytes) -> int:
    return int.from_bytes(packet[2:4], "big") % COUNT_14


def new_packets(known: Iterable[bytes], came: Iterable[bytes]) -> list[bytes]:
    """Return the received packets that are not known, each once, in order of arrival."""
    seen = set(known)
    found = []
    for packet in came:
        if packet not in seen:
            seen.add(packet)
            found.append(packet)
    return found
