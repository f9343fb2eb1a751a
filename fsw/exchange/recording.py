"""Reads MCAP recordings, whole or truncated, in log-time order.

`/can/<bus>` holds one Linux struct can_frame (16 bytes) or canfd_frame (72 bytes) per message,
`/serial/<device>` bytes as read, `/samples/<source>` decoded samples as JSON. All other topics hold
JSON. `log_time` is the receive stamp [ns].
"""

from __future__ import annotations

import struct
import zlib
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, ChunkIndex, Metadata
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary
from zstandard import ZstdError

from file_delivery.regular import open_regular
from fsw.config.text import MAX_TEXT_BYTES, kind_of
from fsw.errors import ConfigError
from fsw.exchange.chunks import expanded
from fsw.exchange.columns import Column, windows
from fsw.messages import IntArray

SAMPLES = "/samples/"  # prefix of topics of decoded samples: JSON, values as the sensor gave them
SAMPLED = "samples"  # metadata of a recording with decoded samples: names of its joints
NO_KIND = "of another kind; fsw import makes a recording of CSV, .npz, ROS 2 bags and CAN logs"
END_NS = 1 << 63  # later than every valid time
MAX_IN_MEMORY = 4 << 30  # bytes of a file without an index, which is read whole
_RECORD_HEAD = struct.Struct("<BQ")  # MCAP: opcode, length
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # MCAP: channel, sequence, log time, publish time
_RECORD = struct.Struct("<BQH4xQ8x")  # both heads, without sequence and publish time
_INDEX = struct.Struct("<BQHI")  # MCAP: opcode, length, channel, bytes of (log time, place) pairs
_HEADS = np.dtype(  # heads of messages, as `_RECORD`
    {
        "names": ["opcode", "length", "channel", "t_ns"],
        "formats": ["u1", "<u8", "<u2", "<i8"],
        "offsets": [0, 1, 9, 15],
        "itemsize": _RECORD.size,
    }
)


class RecordedMessage(NamedTuple):
    """One message of a recording."""

    t_ns: int
    place: tuple[int, ...]  # place in the files: orders messages of equal time
    topic: str
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """Content of a recording besides messages."""

    topics: tuple[str, ...]
    attachments: dict[str, bytes]
    metadata: dict[str, dict[str, str]]
    truncated: bool


def contents(path: Path) -> Contents:
    """Return topics, attachments and metadata of a recording, truncated or not.

    Raises
    ------
    ConfigError when the file cannot be read or is not an MCAP file.
    """
    with _open(path) as file:
        whole_file = _whole_contents(file)
        if whole_file is not None:
            return whole_file
    topics: dict[str, None] = {}
    attachments: dict[str, bytes] = {}
    metadata: dict[str, dict[str, str]] = {}
    whole = _Ended()
    for record in _stream(path, whole):
        if isinstance(record, Channel):
            topics[record.topic] = None
        elif isinstance(record, Attachment):
            attachments[record.name] = record.data
        elif isinstance(record, Metadata):
            metadata[record.name] = record.metadata
    return Contents(
        topics=tuple(topics),
        attachments=attachments,
        metadata=metadata,
        truncated=not whole.ended,
    )


def first_metadata(path: Path, name: str) -> dict[str, str]:
    """Return the first metadata record of a name without reading further; {} if none exists.

    Raises
    ------
    ConfigError when the file cannot be read or is not an MCAP file.
    """
    for record in _stream(path, _Ended()):
        if isinstance(record, Metadata) and record.name == name:
            return record.metadata
    return {}


def messages(path: Path, topics: Sequence[str]) -> Iterator[RecordedMessage]:
    """Yield the messages of some topics of one file; see `messages_of`."""
    return messages_of([path], topics)


def messages_of(parts: Sequence[Path], topics: Sequence[str]) -> Iterator[RecordedMessage]:
    """Yield the messages of some topics of all parts in log-time order, ties in file order.

    Raises
    ------
    ConfigError when a file cannot be read or is damaged.
    """
    held: list[RecordedMessage] = []
    for piece, following_ns in pieces_of(parts, topics):
        for topic, column in piece.read().items():
            held += [
                RecordedMessage(
                    t_ns, (piece.part, piece.offset, start), topic, column.data[start:stop]
                )
                for t_ns, start, stop in column.spans.tolist()
            ]
        held.sort()
        ready = bisect_left(held, following_ns, key=lambda item: item.t_ns)
        yield from held[:ready]
        del held[:ready]


def pieces_of(parts: Sequence[Path], topics: Sequence[str]) -> Iterator[tuple[Piece, int]]:
    """Yield the pieces of all parts in order of start, each with the next one's start [ns].

    A whole file is read chunk by chunk through its index. A truncated file has no index: it is
    one piece, read into memory up to the break.

    Raises
    ------
    ConfigError when a file cannot be read.
    """
    wanted = set(topics)
    found = [piece for number, path in enumerate(parts) for piece in _pieces(path, number, wanted)]
    found.sort(key=lambda piece: (piece.start_ns, piece.part, piece.offset))
    following_ns = [*(piece.start_ns for piece in found[1:]), END_NS]
    yield from zip(found, following_ns, strict=False)


def _whole_contents(file: IO[bytes]) -> Contents | None:
    """Return the contents that the file's summary lists; None if it is missing or damaged."""
    try:
        reader = make_reader(file)
        summary = reader.get_summary()
        if summary is None:
            return None
        return Contents(
            topics=tuple(channel.topic for channel in summary.channels.values()),
            attachments={item.name: item.data for item in reader.iter_attachments()},
            metadata={item.name: item.metadata for item in reader.iter_metadata()},
            truncated=False,
        )
    except _BROKEN:
        return None


def _summary(file: IO[bytes]) -> Summary | None:
    try:
        return make_reader(file).get_summary()
    except _BROKEN:
        return None


@dataclass(frozen=True, slots=True)
class Piece:
    """A piece of a file that can be read independently."""

    start_ns: int
    part: int
    offset: int
    read: Callable[[], dict[str, Column]]  # by topic; raises ConfigError when the piece is damaged


def _pieces(path: Path, part: int, wanted: set[str]) -> Iterator[Piece]:
    with _open(path) as file:
        summary = _summary(file)
    if summary is not None and summary.chunk_indexes:
        topics = {i: c.topic for i, c in summary.channels.items() if c.topic in wanted}
        for index in summary.chunk_indexes:
            held = index.message_index_offsets  # by channel; empty if the writer made none
            if held and held.keys().isdisjoint(topics):
                continue
            start_ns, offset = index.message_start_time, index.chunk_start_offset
            read = partial(_read_chunk, path, index, topics)
            yield Piece(start_ns, part, offset, read)
        return
    found = _streamed(path, wanted)
    if found:
        start_ns = min(int(column.spans[:, 0].min()) for column in found.values())
        yield Piece(start_ns, part, 0, lambda: found)


def _streamed(path: Path, wanted: set[str]) -> dict[str, Column]:
    """Return the messages of a file without an index, up to its end or break."""
    names: dict[int, str] = {}
    data = bytearray()
    spans: dict[str, list[tuple[int, int, int]]] = {}
    for record in _stream(path, _Ended()):
        if isinstance(record, Channel):
            names[record.id] = record.topic
        elif isinstance(record, McapMessage) and names.get(record.channel_id) in wanted:
            if record.log_time >= END_NS:
                raise ConfigError(f"{path}: damaged: a message at {record.log_time} ns")
            start = len(data)
            if start + len(record.data) > MAX_IN_MEMORY:
                words = f"no index, and more than {MAX_IN_MEMORY} bytes of messages"
                raise ConfigError(f"{path}: {words}: record it in parts (recorder.part_bytes)")
            data += record.data
            span = (record.log_time, start, len(data))
            spans.setdefault(names[record.channel_id], []).append(span)
    whole = bytes(data)
    return {topic: Column(whole, np.array(found, np.int64)) for topic, found in spans.items()}


def _read_chunk(path: Path, index: ChunkIndex, topics: Mapping[int, str]) -> dict[str, Column]:
    start_ns, offset = index.message_start_time, index.chunk_start_offset
    try:
        with _open(path) as file:
            file.seek(offset + _RECORD_HEAD.size)
            data = expanded(Chunk.read(ReadDataStream(file))).data
            places = _places(file.read(index.message_index_length))
        found = _indexed(data, places, topics)
        found = _columns(data, topics) if found is None else found
        for column in found.values():
            times_ns = column.spans[:, 0]  # times from END_NS on are negative here
            if not start_ns <= int(times_ns.min()):
                raise ValueError("messages before the time its index says, or after every time")
    except _BROKEN as error:
        words = "what is before may be used: --to S, in seconds from its start"
        raise ConfigError(f"{path}: damaged at byte {offset}: {error}; {words}") from error
    return found


def _places(indexes: bytes) -> IntArray:
    """Return the ascending places at which a chunk's messages begin, from its indexes."""
    at, found = 0, [np.empty(0, np.int64)]
    while at + _INDEX.size <= len(indexes):
        _, length, _, size = _INDEX.unpack_from(indexes, at)
        pairs = indexes[at + _INDEX.size :][: size // 16 * 16]
        found.append(np.frombuffer(pairs[: len(pairs) // 16 * 16], np.int64)[1::2])
        at += _RECORD_HEAD.size + length
    return np.sort(np.concatenate(found))


def _indexed(data: bytes, at: IntArray, topics: Mapping[int, str]) -> dict[str, Column] | None:
    """Return the result of `_columns` from the places `at` of messages; None if they are wrong.

    The places are right if each message ends where the next one begins, and the last one ends with
    the chunk.
    """
    size = len(data)
    if not at.size or at[0] != 0 or at[-1] > size - _HEADS.itemsize:
        return None
    heads = windows(data, _HEADS.itemsize)[at].view(_HEADS)
    stops = at + _RECORD_HEAD.size + heads["length"].astype(np.int64)
    is_message = heads["opcode"] == int(Opcode.MESSAGE)
    follows = (stops == np.append(at[1:], size)) & (stops - at >= _HEADS.itemsize)
    if not (is_message & follows).all():
        return None
    spans = np.stack([heads["t_ns"], at + _HEADS.itemsize, stops], axis=1)
    channels = heads["channel"]
    own = {
        topic: spans.take(np.flatnonzero(channels == channel), axis=0)
        for channel, topic in topics.items()
    }
    return {topic: Column(data, found) for topic, found in own.items() if len(found)}


def _columns(data: bytes, topics: Mapping[int, str]) -> dict[str, Column]:
    """Return the messages in a chunk by topic. Raises ValueError for a cut record."""
    spans: dict[int, list[tuple[int, int, int]]] = {channel: [] for channel in topics}
    at, size, head, body = 0, len(data), _RECORD_HEAD.size, _RECORD_HEAD.size + _MESSAGE_HEAD.size
    unpack, message = _RECORD.unpack_from, int(Opcode.MESSAGE)
    padded = data + bytes(_RECORD.size)
    while at < size:
        opcode, length, channel, t_ns = unpack(padded, at)
        stop = at + head + length
        if opcode == message and channel in spans:
            spans[channel].append((t_ns, at + body, stop))
        at = stop
    if at > size:
        raise ValueError("a record longer than its chunk")
    return {
        topics[channel]: Column(data, np.array(found, np.uint64).astype(np.int64))
        for channel, found in spans.items()
        if found
    }


@dataclass(slots=True)
class _Ended:
    ended: bool = False


def _open(path: Path) -> IO[bytes]:
    try:
        return open_regular(path, "rb")
    except OSError as error:
        words = f"it is {NO_KIND}" if path.is_dir() else error.strerror
        raise ConfigError(f"{path}: cannot be read: {words}") from error


def _stream(path: Path, whole: _Ended) -> Iterator[object]:
    """Yield records up to the end or the break; set `whole.ended` at the end."""
    with _open(path) as file:
        size = path.stat().st_size
        limit = max(size, 1)
        reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=limit)
        seen = False
        try:
            for record in reader.records:
                seen = True
                if isinstance(record, Chunk):
                    yield from breakup_chunk(expanded(record))
                else:
                    yield record
        except _BROKEN as error:
            if not seen:
                with _open(path) as begun:
                    kind = kind_of(begun.read(MAX_TEXT_BYTES)) or NO_KIND
                words = f"it is {kind}" if size else "it is empty"
                raise ConfigError(f"{path}: not an MCAP recording: {words}") from error
            return
        whole.ended = True


# errors that the MCAP reader raises for a broken file: RuntimeError comes from lz4, the last three
# from an impossible length or place
_BROKEN = (
    McapError,
    ValueError,
    struct.error,
    zlib.error,
    EOFError,
    RuntimeError,
    ZstdError,
    MemoryError,
    OverflowError,
    OSError,
)
