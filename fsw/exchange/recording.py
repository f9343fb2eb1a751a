"""MCAP recordings: writing them, and reading whole or truncated ones in log-time order.

`/can/<bus>` holds one Linux struct can_frame (16 bytes) or canfd_frame (72 bytes) per message,
`/serial/<device>` bytes as read, the rest JSON. `log_time` is the receive stamp [ns].
"""

from __future__ import annotations

import json
import struct
import zlib
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Message, Metadata
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.summary import Summary
from mcap.writer import CompressionType, Writer
from zstandard import ZstdError

from fsw.drivers.wire import pack_frame
from fsw.exchange.sinks import CanTraffic, RawTraffic, SerialTraffic
from fsw.messages.errors import ConfigError

_RECORD_HEAD = struct.Struct("<BQ")  # MCAP: opcode, length
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # MCAP: channel, sequence, log time, publish time
COMPRESSION = {
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
    "none": CompressionType.NONE,
}
_SCHEMAS: dict[str, dict[str, Any]] = {
    "/estimate": {
        "t_ns": "integer",
        "valid": "boolean",
        "reason": "string",
        "method": "string",
        "names": "array",
        "mean": "array",
        "covariance": "array",
        "estimate": "object",
        "sigma": "object",
        "blocks": "integer",
        "gated": "integer",
    },
    "/events": {"t_ns": "integer", "severity": "string", "code": "string", "text": "string"},
    "/tm": {"t_ns": "integer", "ticks": "integer", "slips": "integer", "samples": "object"},
    "/tc": {
        "command": "string",
        "id": "integer",
        "args": "object",
        "next_window": "integer",
        "clean_window": "integer",
    },
}


def raw_traffic(message: CanTraffic | SerialTraffic) -> RawTraffic:
    """Return traffic as a recording holds it: Linux CAN structures, or bytes as they were read."""
    if isinstance(message, CanTraffic):
        records = [(frame.t_ns, pack_frame(frame)) for frame in message.frames]
        return RawTraffic(f"/can/{message.bus}", "socketcan", records)
    chunks = [(chunk.t_ns, chunk.data) for chunk in message.chunks]
    return RawTraffic(f"/serial/{message.device}", "raw", chunks)


class RecordingWriter:
    """One MCAP file. Finished chunks reach the file, so a kill loses at most the last one.

    Raises OSError from any method when the file cannot be written.
    """

    def __init__(self, path: Path, compression: str = "zstd", chunk_bytes: int = 65536) -> None:
        self.path = path
        self._file: IO[bytes] = path.open("wb")
        self._writer = Writer(
            self._file, chunk_size=chunk_bytes, compression=COMPRESSION[compression]
        )
        self._writer.start(profile="", library="fsw")
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}

    @property
    def size_bytes(self) -> int:
        """Bytes written so far; the open chunk not counted."""
        return self._file.tell()

    def attach(self, name: str, media_type: str, data: bytes, t_ns: int = 0) -> None:
        """Add an attachment."""
        self._writer.add_attachment(t_ns, t_ns, name, media_type, data)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(name, dict(values))

    def traffic(self, traffic: CanTraffic | SerialTraffic | RawTraffic) -> None:
        """Add traffic of a link, one message for every frame or chunk."""
        if not isinstance(traffic, RawTraffic):
            traffic = raw_traffic(traffic)
        for t_ns, data in traffic.records:
            self._add(traffic.topic, traffic.encoding, t_ns, data)

    def json(self, topic: str, t_ns: int, values: Mapping[str, Any]) -> None:
        """Add one JSON message."""
        try:
            text = json.dumps(values, allow_nan=False)
        except ValueError:  # JSON has no NaN or infinity: null
            text = json.dumps(json.loads(json.dumps(values), parse_constant=lambda _: None))
        self._add(topic, "json", t_ns, text.encode())

    def sync(self) -> None:
        """Hand finished chunks to the system."""
        self._file.flush()

    def end_chunk(self) -> None:
        """Finish the chunk in progress and hand it to the system."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Write index and footer, release the file."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Release the file as it is, after a failure."""
        try:
            self._file.close()
        except OSError:
            return

    def _add(self, topic: str, encoding: str, t_ns: int, data: bytes) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._register(topic, encoding)
        sequence = self._sequence.get(topic, 0)
        self._sequence[topic] = sequence + 1
        self._writer.add_message(channel, t_ns, data, t_ns, sequence & 0xFFFFFFFF)

    def _register(self, topic: str, encoding: str) -> int:
        schema = 0
        if encoding == "json":
            properties = {key: {"type": kind} for key, kind in _SCHEMAS[topic].items()}
            text = json.dumps({"type": "object", "properties": properties})
            schema = self._writer.register_schema(topic.strip("/"), "jsonschema", text.encode())
        return self._writer.register_channel(topic, encoding, schema)


@dataclass(frozen=True, slots=True)
class Record:
    """One message of a recording."""

    topic: str
    t_ns: int
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
    ConfigError when the file cannot be read or is no MCAP file.
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
    """Return the first metadata record of a name, without reading further; {} if there is none.

    Raises
    ------
    ConfigError when the file cannot be read or is no MCAP file.
    """
    for record in _stream(path, _Ended()):
        if isinstance(record, Metadata) and record.name == name:
            return record.metadata
    return {}


def messages(path: Path, topics: Sequence[str]) -> Iterator[Record]:
    """Yield the messages of some topics in log-time order, ties in file order.

    A whole file is read chunk by chunk through its index. A truncated one has none: it is read up
    to the break into memory and sorted.
    """
    wanted = set(topics)
    with _open(path) as file:
        summary = _summary(file)
        if summary is not None and summary.chunk_indexes:
            yield from _indexed(path, file, summary, wanted)
            return
    names: dict[int, str] = {}
    found: list[Record] = []
    for record in _stream(path, _Ended()):
        if isinstance(record, Channel):
            names[record.id] = record.topic
        elif isinstance(record, Message) and names.get(record.channel_id) in wanted:
            found.append(Record(names[record.channel_id], record.log_time, record.data))
    yield from sorted(found, key=lambda record: record.t_ns)


def _whole_contents(file: IO[bytes]) -> Contents | None:
    """Return what the summary and what it points at say; None of a file without, or a wrong one."""
    summary = _summary(file)
    if summary is None:
        return None
    try:
        reader = make_reader(file)
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


def _indexed(path: Path, file: IO[bytes], summary: Summary, wanted: set[str]) -> Iterator[Record]:
    """Yield the messages of a whole file; holds as many chunks as overlap in time."""
    topics = {i: c.topic for i, c in summary.channels.items() if c.topic in wanted}
    chunks = sorted(
        summary.chunk_indexes, key=lambda c: (c.message_start_time, c.chunk_start_offset)
    )
    starts = [chunk.message_start_time for chunk in chunks[1:]]
    held: list[tuple[int, int, int, str, bytes]] = []  # time, place in the file, topic, data
    for position, index in enumerate(chunks):
        offset = index.chunk_start_offset
        try:
            file.seek(offset + 9)
            stream, size = get_chunk_data_stream(Chunk.read(ReadDataStream(file)), True)
            data = stream.read(size)
            found = _chunk_messages(data, offset, topics)
            if found and min(found)[0] < index.message_start_time:
                raise ValueError("messages before the time its index says")
            held += found
        except _BROKEN as error:
            raise ConfigError(f"{path}: damaged at byte {offset}: {error}") from error
        held.sort()
        ready = len(held)
        if position < len(starts):
            ready = bisect_left(held, starts[position], key=lambda item: item[0])
        for t_ns, _, _, topic, payload in held[:ready]:
            yield Record(topic, t_ns, payload)
        del held[:ready]


def _chunk_messages(
    data: bytes, chunk: int, topics: Mapping[int, str]
) -> list[tuple[int, int, int, str, bytes]]:
    found = []
    at = 0
    while at < len(data):
        opcode, length = _RECORD_HEAD.unpack_from(data, at)
        start, at = at + _RECORD_HEAD.size, at + _RECORD_HEAD.size + length
        if opcode == Opcode.MESSAGE:
            channel, _, t_ns, _ = _MESSAGE_HEAD.unpack_from(data, start)
            topic = topics.get(channel)
            if topic is not None:
                found.append((t_ns, chunk, start, topic, data[start + _MESSAGE_HEAD.size : at]))
    return found


@dataclass(slots=True)
class _Ended:
    ended: bool = False


def _open(path: Path) -> IO[bytes]:
    try:
        return path.open("rb")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error


def _stream(path: Path, whole: _Ended) -> Iterator[object]:
    """Yield records up to the end or the break."""
    with _open(path) as file:
        size = path.stat().st_size
        reader = StreamReader(file, validate_crcs=True, record_size_limit=max(size, 1))
        seen = False
        try:
            for record in reader.records:
                seen = True
                yield record
        except _BROKEN as error:
            if not seen:
                raise ConfigError(f"{path}: not an MCAP recording: {error}") from error
            return
        whole.ended = True


# what a broken file can raise in the MCAP reader: RuntimeError is lz4's, the last three come of a
# length or place that no file has
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
