"""Writes MCAP recordings; `fsw.exchange.recording` describes the format."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from mcap.writer import CompressionType

from file_delivery.regular import open_regular
from fsw.config.actuators import SAMPLED
from fsw.drivers.wire import recorded_bytes, recorded_columns
from fsw.exchange.batch_writer import BatchWriter
from fsw.exchange.sinks import CanTraffic, SerialTraffic

COMPRESSION = {
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
    "none": CompressionType.NONE,
}
_LISTS = {"strings": "string", "numbers": "number"}
_SCHEMAS: dict[str, dict[str, str]] = {  # without `covariance`: Foxglove reads no list of lists
    "/estimate": {
        "t_ns": "integer",
        "valid": "boolean",
        "reason": "string",
        "reasons": "strings",
        "method": "string",
        "names": "strings",
        "mean": "numbers",
        "estimate": "object",
        "sigma": "object",
        "blocks": "integer",
        "gated": "integer",
    },
    "/events": {"t_ns": "integer", "severity": "string", "code": "string", "text": "string"},
    "/tm": {"t_ns": "integer", "ticks": "integer", "slips": "integer", "samples": "object"},
    "/samples/joints": {  # by name; metres and newtons are of prismatic joints
        "position_rad": "object",
        "torque_nm": "object",
        "position_m": "object",
        "force_n": "object",
    },
    **{f"/samples/{section}": device.columns for section, device in SAMPLED.items()},
    "/samples/imu": {"w_NS_S_rad_s": "numbers", "f_NS_S_m_s2": "numbers"},
    "/samples/star_tracker": {"q_xyzw": "numbers"},
    "/tc": {
        "command": "string",
        "id": "integer",
        "args": "object",
        "next_window": "integer",
        "clean_window": "integer",
    },
}


def schema_of(topic: str) -> dict[str, Any]:
    """Return the JSON Schema of a topic, in the part of JSON Schema that Foxglove supports."""
    properties: dict[str, Any] = {}
    for key, kind in _SCHEMAS[topic].items():
        items = {"items": {"type": _LISTS[kind]}} if kind in _LISTS else {}
        properties[key] = {"type": "array" if items else kind, **items}
    return {"type": "object", "properties": properties}


class RecordingWriter:
    """Writes one MCAP file. Finished chunks are in the file, so a kill loses only the open chunk.

    Raises OSError from any method when the file cannot be written.
    """

    def __init__(self, path: Path, compression: str = "zstd", chunk_bytes: int = 65536) -> None:
        self.path = path
        self._file: IO[bytes] = open_regular(path, "wb")
        self._writer = BatchWriter(
            self._file, chunk_size=chunk_bytes, compression=COMPRESSION[compression]
        )
        self._writer.start(profile="", library="fsw")
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}

    @property
    def size_bytes(self) -> int:
        """Bytes written so far; the open chunk not counted."""
        return self._file.tell()

    @property
    def is_removed(self) -> bool:
        """Whether the file has lost its name, so that nothing more of it can be read."""
        try:
            return not os.path.samestat(self.path.stat(), os.fstat(self._file.fileno()))
        except (FileNotFoundError, NotADirectoryError):
            return True
        except OSError:
            return False

    @property
    def open_messages(self) -> int:
        """Number of messages in the open chunk, which is not in the file yet."""
        return self._writer.open_messages

    def attach(self, name: str, media_type: str, data: bytes, t_ns: int = 0) -> None:
        """Add an attachment."""
        self._writer.add_attachment(t_ns, t_ns, name, media_type, data)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(name, dict(values))

    def traffic(self, traffic: CanTraffic | SerialTraffic) -> None:
        """Add traffic of a link, one message for every frame or chunk."""
        if isinstance(traffic, CanTraffic):
            topic, frames = f"/can/{traffic.bus}", traffic.frames
            columns = recorded_columns(frames)
            if columns is not None:
                channel, sequence = self._next(topic, "socketcan", len(frames))
                self._writer.add_messages(channel, frames["t_ns"], columns, sequence)
                return
            for t_ns, data in zip(frames["t_ns"].tolist(), recorded_bytes(frames), strict=True):
                self._add(topic, "socketcan", t_ns, data)
        else:
            for chunk in traffic.chunks:
                self._add(f"/serial/{traffic.device}", "raw", chunk.t_ns, chunk.data)

    def json(self, topic: str, t_ns: int, values: Mapping[str, Any]) -> None:
        """Add one JSON message; NaN and infinity become null."""
        try:
            text = json.dumps(values, allow_nan=False)
        except ValueError:  # JSON has no NaN or infinity: null
            text = json.dumps(json.loads(json.dumps(values), parse_constant=lambda _: None))
        self._add(topic, "json", t_ns, text.encode())

    def sync(self) -> None:
        """Flush finished chunks to the operating system."""
        self._file.flush()

    def end_chunk(self) -> None:
        """Finish the open chunk and write it to the file."""
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
        channel, sequence = self._next(topic, encoding, 1)
        self._writer.add_message(channel, t_ns, data, t_ns, sequence & 0xFFFFFFFF)

    def _next(self, topic: str, encoding: str, count: int) -> tuple[int, int]:
        """Return a topic's channel and the sequence number of the next of `count` messages."""
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._register(topic, encoding)
        sequence = self._sequence.get(topic, 0)
        self._sequence[topic] = sequence + count
        return channel, sequence

    def _register(self, topic: str, encoding: str) -> int:
        schema = 0
        if encoding == "json":
            text = json.dumps(schema_of(topic))
            schema = self._writer.register_schema(topic.strip("/"), "jsonschema", text.encode())
        return self._writer.register_channel(topic, encoding, schema)
