"""History for the page: a ring of the newest values of each packet, and recordings."""

from __future__ import annotations

import json
import os
import struct
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.exceptions import InvalidMagic, McapError
from mcap.records import Channel, Chunk, McapRecord, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

FIRST_ROWS, MAX_ROWS = 256, 20_000
SAME_CLOCK_MS = 10_000.0
REREAD_S = 30.0  # between two readings of a changed recording; newer values are in memory
ESTIMATES = "/estimate"
TOPICS = (ESTIMATES, "/events")
AXES = ("x", "y", "z")
MAX_CHUNK_BYTES = 64 << 20  # of one chunk, expanded; the recorder closes its own far below
INERTIA = ("xx", "xy", "xz", "yy", "yz", "zz")
Row = tuple[float, float]  # time [ms since 1970], value
# errors of values that are not what the recorder writes, and of a broken file or chunk
_INVALID = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
_DAMAGED = (
    *(McapError, ValueError, OSError, struct.error, RuntimeError, MemoryError, OverflowError),
    zstandard.ZstdError,
)


class Ring:
    """The newest numbers of one packet; at `MAX_ROWS` rows, the older half is discarded."""

    def __init__(self, fields: Sequence[str]) -> None:
        self._places = {field: k for k, field in enumerate(fields, start=1)}
        self._rows = np.empty((FIRST_ROWS, len(fields) + 1))
        self._count = 0

    def add(self, t_ms: float, numbers: Mapping[str, float]) -> None:
        """Store the numbers of one packet by field; missing ones are NaN."""
        if self._count == len(self._rows):
            if self._count < MAX_ROWS:
                self._rows = np.concatenate((self._rows, np.empty_like(self._rows)))
            else:
                half = self._count // 2
                self._rows[:half] = self._rows[self._count - half : self._count]
                self._count = half
        row = self._rows[self._count]
        row[:] = np.nan
        row[0] = t_ms
        for field, value in numbers.items():
            place = self._places.get(field)
            if place is not None:
                row[place] = value
        self._count += 1

    def between(self, field: str, start_ms: float, end_ms: float) -> NDArray[np.float64]:
        """Return times [ms] and values (n, 2) of a field within an interval."""
        rows = self._rows[: self._count]
        first, last = np.searchsorted(rows[:, 0], (start_ms, end_ms))
        return rows[first:last][:, [0, self._places[field]]]


def thinned(rows: NDArray[np.float64], size: int) -> list[Row]:
    """Return at most about `size` rows: the lowest and the highest value of equal parts."""
    rows = rows[np.isfinite(rows[:, 1])]
    if size <= 0 or len(rows) <= size:
        return [(float(t), float(v)) for t, v in rows]
    kept: list[Row] = []
    for part in np.array_split(rows, max(1, size // 2)):
        extremes = sorted({int(np.argmin(part[:, 1])), int(np.argmax(part[:, 1]))})
        kept += [(float(part[k, 0]), float(part[k, 1])) for k in extremes]
    return kept


class Recordings:
    """Estimates and events of recordings, read on request.

    Parameters
    ----------
    path : a recording, or a folder of recordings; None: there are none
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._read: dict[Path, tuple[tuple[int, int], float, RecordedStream]] = {}
        self._lock = threading.Lock()  # a page sends many requests at once

    def between(
        self, field: str, start_ms: float, end_ms: float, offset_ms: float | None
    ) -> NDArray[np.float64]:
        """Return times [ms] and values (n, 2) of a field of the estimate within an interval.

        Parameters
        ----------
        offset_ms : time of day less the daemon's clock; None: not known
        """
        found = [np.empty((0, 2))]
        for recorded in self._recorded():
            column = recorded.columns.get(field)
            if column is None:
                continue
            times = recorded.times_ms + recorded.offset_ms(offset_ms)
            first, last = np.searchsorted(times, (start_ms, end_ms))
            found.append(np.column_stack((times[first:last], column[first:last])))
        return np.concatenate(found)

    def events(
        self, start_ms: float, end_ms: float, offset_ms: float | None
    ) -> list[dict[str, Any]]:
        """Return the events within an interval, with their time of day `utc` [ms]."""
        found = []
        for recorded in self._recorded():
            shift = recorded.offset_ms(offset_ms)
            found += [
                {**event, "utc": t_ms + shift}
                for t_ms, event in recorded.events
                if start_ms <= t_ms + shift <= end_ms
            ]
        return found

    def _recorded(self) -> Iterator[RecordedStream]:
        """Yield the recordings that hold estimates or events, in order of their names."""
        if self._path is None:
            return
        files = sorted(self._path.glob("*.mcap")) if self._path.is_dir() else [self._path]
        for path in files:
            with self._lock:
                recorded = self._newest(path)
            if recorded is not None and (len(recorded.times_ms) or recorded.events):
                yield recorded

    @property
    def unreadable(self) -> list[str]:
        """Return a line for each recording that was read in part only or not at all."""
        with self._lock:
            kept = [(path, entry[2]) for path, entry in self._read.items()]
        return [
            f"{path.name}: {own.damage}" for path, own in kept if own is not None and own.damage
        ]

    def _newest(self, path: Path) -> RecordedStream | None:
        """Return a recording, None if it is gone; read a changed one again after `REREAD_S`."""
        try:
            facts, now_s = path.stat(), time.monotonic()
        except OSError:
            return None
        mark = facts.st_mtime_ns, facts.st_size
        known = self._read.get(path)
        if known is None or (known[0] != mark and now_s - known[1] > REREAD_S):
            self._read[path] = known = (mark, now_s, read_recording(path))
        return known[2]


@dataclass(frozen=True, slots=True, eq=False)
class RecordedStream:
    """Contents of one recording on the daemon's clock."""

    times_ms: NDArray[np.float64]
    columns: Mapping[str, NDArray[np.float64]]
    events: Sequence[tuple[float, Mapping[str, str]]]
    changed_ms: float  # time of day of the file's last change
    last_ms: float
    damage: str = ""  # why the rest of it cannot be read

    def offset_ms(self, known_ms: float | None) -> float:
        """Return the time of day less the daemon's clock [ms].

        A recording does not contain the time of day. Its last message is assumed to be as old as
        the last change of its file. If this offset is close to `known_ms`, that one is returned.
        """
        own_ms = self.changed_ms - self.last_ms
        if known_ms is not None and abs(known_ms - own_ms) < SAME_CLOCK_MS:
            return known_ms
        return own_ms


def read_recording(path: Path) -> RecordedStream:
    """Read a recording, complete or still being written, up to its last readable message.

    A message with invalid content is left out, as are those behind damage of the file. Both are
    named in `damage`. A file without its end is still being written, or was cut by a power failure.
    """
    times: list[float] = []
    rows: list[dict[str, float]] = []
    events: list[tuple[float, dict[str, str]]] = []
    last_ms, invalid, damage = 0.0, 0, ""
    try:
        for topic, t_ns, data in _messages(path):
            t_ms = t_ns / 1e6
            last_ms = max(last_ms, t_ms)
            try:
                values = json.loads(data)
                if topic == ESTIMATES:
                    rows.append(estimate_fields(values))
                    times.append(t_ms)
                else:
                    event = {name: str(values[name]) for name in ("severity", "code", "text")}
                    events.append((t_ms, event))
            except _INVALID:
                invalid += 1
    except InvalidMagic:
        damage = "not an MCAP file"
    except _DAMAGED as error:
        damage = f"damaged: {str(error) or type(error).__name__}" if _is_closed(path) else ""
    if invalid:
        damage = "; ".join(filter(None, (damage, f"{invalid} messages with invalid content")))
    names = {name for row in rows for name in row}
    columns = {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}
    try:
        changed_ms = path.stat().st_mtime_ns / 1e6
    except OSError:
        changed_ms = last_ms
    return RecordedStream(np.array(times), columns, events, changed_ms, last_ms, damage)


def _is_closed(path: Path) -> bool:
    """Return whether a file ends as a finished recording does."""
    try:
        with path.open("rb") as file:
            file.seek(-len(MCAP0_MAGIC), os.SEEK_END)
            return file.read() == MCAP0_MAGIC
    except OSError:
        return False


def _messages(path: Path) -> Iterator[tuple[str, int, bytes]]:
    """Yield topic, log time [ns] and data of the messages of a recording in file order."""
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        size = max(path.stat().st_size, 1)
        reader = StreamReader(file, emit_chunks=True, record_size_limit=size)
        for record in reader.records:
            for one in _expanded(record) if isinstance(record, Chunk) else [record]:
                if isinstance(one, Channel):
                    topics[one.id] = one.topic
                elif isinstance(one, Message) and topics.get(one.channel_id) in TOPICS:
                    yield topics[one.channel_id], one.log_time, one.data


def _expanded(chunk: Chunk) -> Sequence[McapRecord]:
    """Return the records in a chunk. Raises ValueError if it expands too far."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        size = max(size, zstandard.frame_content_size(chunk.data))
    if size > MAX_CHUNK_BYTES:
        raise ValueError(f"a chunk of {size} bytes; at most {MAX_CHUNK_BYTES} are read")
    return breakup_chunk(chunk, validate_crc=True)


def estimate_fields(values: Mapping[str, Any]) -> dict[str, float]:
    """Return a recorded estimate as the fields of the telemetry packet `estimate`."""
    fields: dict[str, float] = {"valid": float(values["valid"])}
    for name in ("blocks", "gated", "nis", "nis_dof", "condition_number"):
        if isinstance(values.get(name), int | float):
            fields[name] = float(values[name])
    for body, numbers in values["estimate"].items():
        sigmas = values["sigma"][body]
        pairs = list(zip(_flat(numbers), _flat(sigmas), strict=True))
        for (name, value), (_, sigma) in pairs:
            fields[f"{body}_{name}"] = value
            fields[f"{body}_sigma_{name}"] = sigma
            fields[f"{body}_{name}_low"] = value - sigma
            fields[f"{body}_{name}_high"] = value + sigma
    return fields


def _flat(body: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    yield "mass_kg", float(body["mass_kg"])
    for axis, value in zip(AXES, body["com_m"], strict=True):
        yield f"com_{axis}_m", float(value)
    for pair, value in zip(INERTIA, body["inertia_kg_m2"], strict=True):
        yield f"inertia_{pair}_kg_m2", float(value)
