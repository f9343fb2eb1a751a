import json
import random
import tracemalloc
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from fsw.drivers.wire import (
    ByteChunk,
    CanFrame,
    FrameArray,
    frame_array,
    frame_list,
    pack_frame,
    unpack_frame,
)
from fsw.errors import ConfigError
from fsw.exchange.columns import frames_of
from fsw.exchange.recording import contents, messages, pieces_of
from fsw.exchange.recording_writer import RecordingWriter
from fsw.exchange.sinks import CanTraffic, SerialTraffic

# struct can_frame / canfd_frame of <linux/can.h>: id with flag bits, length, flags, padding, data
CLASSIC = bytes.fromhex("91010000 08 000000 0712cdff2efb092a")
CLASSIC_FRAME = CanFrame(5, 0x191, bytes.fromhex("0712cdff2efb092a"))
FRAMES = [
    CanFrame(1, 0x80, b"\x01"),
    CanFrame(2, 0x1ABCDEF0, b"xy", is_extended=True),
    CanFrame(3, 0x7FF, b"", is_remote=True),
    CanFrame(4, 0x20, b"\x00" * 8, is_error=True),
    CanFrame(5, 0x191, bytes(range(20)), is_fd=True, bitrate_switch=True),
    CanFrame(6, 0x191, bytes(64), is_fd=True),
]


def test_a_classic_frame_is_the_linux_structure():
    assert pack_frame(CLASSIC_FRAME) == CLASSIC
    assert unpack_frame(5, CLASSIC) == CLASSIC_FRAME


def test_flag_bits_are_those_of_linux():
    assert pack_frame(FRAMES[1])[:4] == bytes.fromhex("f0debc9a")
    assert pack_frame(FRAMES[2])[3] == 0x40
    assert pack_frame(FRAMES[3])[3] == 0x20
    fd = pack_frame(FRAMES[4])
    assert (len(fd), fd[4], fd[5]) == (72, 20, 0x05)


@pytest.mark.parametrize("frame", FRAMES)
def test_every_kind_of_frame_comes_back_equal(frame: CanFrame):
    assert unpack_frame(frame.t_ns, pack_frame(frame)) == frame


@pytest.mark.parametrize("data", [b"", bytes(15), bytes(17), b"\0\0\0\0\x09" + bytes(11)])
def test_what_is_no_linux_frame_is_none(data: bytes):
    assert unpack_frame(0, data) is None


def write(path: Path, seconds: int = 3, **more) -> RecordingWriter:
    writer = RecordingWriter(path, chunk_bytes=4096, **more)
    writer.attach("configuration.yaml", "application/yaml", b"a: 1\n")
    for k in range(seconds * 100):
        writer.traffic(CanTraffic("arm", frame_array([CanFrame(k * 10, 0x80, bytes([k % 256]))])))
        writer.traffic(SerialTraffic("imu", [ByteChunk(k * 10 + 5, bytes([k % 256]) * 40)]))
    writer.json("/events", 7, {"t_ns": 7, "code": "X"})
    return writer


def held(path: Path, topics: list[str]) -> list[tuple[int, str, bytes]]:
    return [(item.t_ns, item.topic, item.data) for item in messages(path, topics)]


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_messages_come_back_in_log_time_order_and_by_topic(tmp_path: Path, compression: str):
    write(tmp_path / "a.mcap", compression=compression).close()
    records = list(messages(tmp_path / "a.mcap", ["/can/arm", "/serial/imu"]))
    assert [r.t_ns for r in records] == list(range(0, 3000, 5))
    assert records[1].data == bytes(40)
    (event,) = messages(tmp_path / "a.mcap", ["/events"])
    assert json.loads(event.data)["code"] == "X"


def test_contents_list_topics_attachments_and_metadata(tmp_path: Path):
    writer = write(tmp_path / "a.mcap")
    writer.metadata("recorder", {"dropped": "3"})
    writer.close()
    found = contents(tmp_path / "a.mcap")
    assert set(found.topics) == {"/can/arm", "/serial/imu", "/events"}
    assert found.attachments == {"configuration.yaml": b"a: 1\n"}
    assert found.metadata == {"recorder": {"dropped": "3"}}
    assert not found.truncated


def test_encodings_and_schemas_are_those_of_the_interface(tmp_path: Path):
    write(tmp_path / "a.mcap").close()
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    encodings = {c.topic: c.message_encoding for c in summary.channels.values()}
    assert encodings == {"/can/arm": "socketcan", "/serial/imu": "raw", "/events": "json"}
    (schema,) = summary.schemas.values()
    assert (schema.name, schema.encoding) == ("events", "jsonschema")
    assert json.loads(schema.data)["type"] == "object"


def test_a_killed_writer_loses_at_most_its_last_chunk(tmp_path: Path):
    writer = write(tmp_path / "a.mcap")
    writer.sync()
    data = (tmp_path / "a.mcap").read_bytes()  # no footer, no index
    (tmp_path / "b.mcap").write_bytes(data)
    writer.close()
    assert contents(tmp_path / "b.mcap").truncated
    whole = held(tmp_path / "a.mcap", ["/can/arm", "/serial/imu"])
    found = held(tmp_path / "b.mcap", ["/can/arm", "/serial/imu"])
    assert found == whole[: len(found)]
    assert (len(whole) - len(found)) * 40 < 2 * 4096


def test_a_file_cut_anywhere_gives_a_sorted_part_and_never_raises(tmp_path: Path):
    write(tmp_path / "a.mcap").close()
    data = (tmp_path / "a.mcap").read_bytes()
    whole = held(tmp_path / "a.mcap", ["/can/arm"])
    cut = tmp_path / "cut.mcap"
    for size in range(200, len(data) - 1, 97):
        cut.write_bytes(data[:size])
        found = held(cut, ["/can/arm"])
        assert found == whole[: len(found)]
        assert contents(cut).truncated


def test_what_is_no_recording_is_a_configuration_error(tmp_path: Path):
    (tmp_path / "x").write_bytes(b"hello, world, this is text")
    with pytest.raises(ConfigError, match="not an MCAP recording"):
        contents(tmp_path / "x")
    with pytest.raises(ConfigError, match="cannot be read"):
        contents(tmp_path / "absent")


def test_numbers_json_has_not_are_null(tmp_path: Path):
    writer = RecordingWriter(tmp_path / "a.mcap")
    writer.json("/tm", 1, {"t_ns": 1, "samples": {"x": float("nan")}})
    writer.close()
    (record,) = messages(tmp_path / "a.mcap", ["/tm"])
    assert json.loads(record.data) == {"t_ns": 1, "samples": {"x": None}}


@pytest.mark.parametrize("whole", [True, False])
def test_a_time_that_no_clock_has_is_damage(tmp_path: Path, whole: bool):
    writer = RecordingWriter(tmp_path / "a.mcap")
    for t_ns in (1, 2**63, 2**64 - 1):
        writer._add("/can/arm", "socketcan", t_ns, CLASSIC)
    writer.end_chunk()
    if whole:
        writer.close()
    else:
        writer.abandon()

    def decoded() -> list[FrameArray]:
        pieces = pieces_of([tmp_path / "a.mcap"], ["/can/arm"])
        return [frames_of([piece.read()["/can/arm"]]) for piece, _ in pieces]

    with pytest.raises(ConfigError, match=r"a\.mcap"):
        decoded()
    with pytest.raises(ConfigError, match=r"a\.mcap"):
        list(messages(tmp_path / "a.mcap", ["/can/arm"]))


def test_a_column_of_mixed_sizes_gives_the_frames_there_are(tmp_path: Path):
    writer = RecordingWriter(tmp_path / "a.mcap", chunk_bytes=1 << 20)
    records = [pack_frame(frame) for frame in FRAMES]
    records[3:3] = [
        b"",
        bytes(15),
        bytes(80),
        b"\0\0\0\0\x09" + bytes(11),
        bytes(4) + b"\x41" + bytes(67),
    ]
    for data in records:
        writer._add("/can/arm", "socketcan", 7, data)
    writer.close()
    ((piece, _),) = pieces_of([tmp_path / "a.mcap"], ["/can/arm"])
    found = frame_list(frames_of([piece.read()["/can/arm"]]))
    assert found == [replace(frame, t_ns=7) for frame in FRAMES]


def test_runs_of_records_of_any_length_are_those_of_the_library(tmp_path: Path):
    writer, rng = RecordingWriter(tmp_path / "a.mcap", chunk_bytes=1 << 16), random.Random(4)
    t_ns = 0
    for count in (1, 7, 8, 9, 10, 300, 2, 40, 1, 1, 30):
        size = rng.choice([0, 1, 38])
        for _ in range(count):
            t_ns += 1
            chunk = ByteChunk(t_ns, rng.randbytes(size))
            writer.traffic(SerialTraffic(rng.choice(["imu", "star"]), [chunk]))
        frames = [CanFrame(t_ns + k, 0x191, rng.randbytes(8)) for k in range(count)]
        writer.traffic(CanTraffic("arm", frame_array(frames)))
    writer.close()
    topics = ["/can/arm", "/serial/imu", "/serial/star"]
    with (tmp_path / "a.mcap").open("rb") as file:
        expected = [
            (message.log_time, channel.topic, message.data)
            for _, channel, message in make_reader(file).iter_messages(topics)
        ]
    assert held(tmp_path / "a.mcap", topics) == expected


@pytest.mark.parametrize("damage", [b"", bytes(7), b"\xff" * 40])
def test_a_message_index_that_does_not_fit_changes_nothing(tmp_path: Path, damage: bytes):
    writer, t_ns = RecordingWriter(tmp_path / "a.mcap", chunk_bytes=1 << 20), 0
    sent = []
    for _ in range(3):
        chunks = [ByteChunk(t_ns := t_ns + 1, bytes(t_ns)) for _ in range(20)]
        writer.traffic(SerialTraffic("imu", chunks))
        writer.end_chunk()
        sent += chunks
    writer.close()
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for index in summary.chunk_indexes:
        at = index.chunk_start_offset + index.chunk_length + 15  # behind the head of its index
        data[at + 24 : at + 24 + len(damage)] = damage
    (tmp_path / "a.mcap").write_bytes(data)
    assert held(tmp_path / "a.mcap", ["/serial/imu"]) == [
        (chunk.t_ns, "/serial/imu", chunk.data) for chunk in sent
    ]


def bomb(path: Path, *, claimed: int, true: int, compression: str) -> None:
    """Write a recording with one chunk of `true` zero bytes that says it has `claimed`."""
    compress = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}[compression]
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel("/events", "json", 0)
        writer.add_message(channel, 7, b"{}", 7)
        writer.finish()
    data = path.read_bytes()
    chunk = next(r for r in StreamReader(BytesIO(data), emit_chunks=True).records if is_chunk(r))
    builder = RecordBuilder()
    chunk.write(builder)
    old = builder.end()
    new = replace(
        chunk,
        compression=compression,
        uncompressed_size=claimed,
        uncompressed_crc=0,
        data=compress(bytes(true)),
    )
    new.write(builder)
    path.write_bytes(data.replace(old, builder.end()))


def is_chunk(record: object) -> bool:
    return isinstance(record, Chunk)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize(
    ("claimed", "true"), [(1 << 31, 1 << 20), (100, 64 << 20), (1 << 40, 100), (200, 100)]
)
def test_a_chunk_that_expands_beyond_bounds_is_damage(
    tmp_path: Path, compression: str, claimed: int, true: int
):
    bomb(tmp_path / "a.mcap", claimed=claimed, true=true, compression=compression)
    tracemalloc.start()
    try:
        contents(tmp_path / "a.mcap")
        assert not list(messages(tmp_path / "a.mcap", ["/events"]))
        assert tracemalloc.get_traced_memory()[1] < 16 << 20
    finally:
        tracemalloc.stop()
