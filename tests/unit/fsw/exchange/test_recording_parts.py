"""Recordings in parts: rotation, a full disk and space again, and reading them as one."""

import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fsw.drivers.wire import ByteChunk
from fsw.errors import ConfigError
from fsw.exchange.recording import messages_of
from fsw.exchange.recording_parts import contents_of, newest_part, parts_of
from fsw.exchange.sinks import SerialTraffic, StatusReport
from fsw.service.recorder import RETRY_NS, Parts, RecorderSink
from tests.conftest import ArmProject
from tests.support.loop_cases import arm_config

MS = 1_000_000
TOPIC = "/serial/imu"


def names(paths: list[Path]) -> list[str]:
    return [path.name for path in paths]


def feed(sink: RecorderSink, first: int, count: int, size: int = 500) -> None:
    """One chunk of random-looking bytes and one status per 100 ms."""
    for k in range(first, first + count):
        sink.put(
            SerialTraffic("imu", [ByteChunk(k * 100 * MS, k.to_bytes(4, "big") * (size // 4))])
        )
        sink.put(StatusReport(k * 100 * MS, {"t_ns": k}))
        sink.sync()


def numbers(parts: list[Path]) -> list[int]:
    return [int.from_bytes(r.data[:4], "big") for r in messages_of(parts, [TOPIC])]


def test_a_recording_goes_on_in_new_files_and_is_read_as_one(
    arm: ArmProject, tmp_path: Path
) -> None:
    parts = Parts(arm_config(arm), tmp_path)
    told: list[str] = []
    sink = RecorderSink(
        parts.open(), lambda _s, code, _t: told.append(code), parts=parts.open, part_s=3.0
    )
    feed(sink, 0, 100)
    sink.close()
    files = parts_of(tmp_path / "recording_0001.mcap")
    assert names(files) == [
        "recording_0001.mcap",
        *(f"recording_0001_{k:04d}.mcap" for k in (2, 3, 4)),
    ]
    assert numbers(files) == list(range(100))
    assert not contents_of(files).truncated
    assert set(contents_of(files[2:3]).attachments) == {"configuration.yaml", "robot.urdf"}
    last = contents_of(files).metadata["part"]
    assert (last["number"], last["first"]) == ("4", "recording_0001.mcap")
    assert told == []


def test_a_large_file_is_followed_by_the_next(arm: ArmProject, tmp_path: Path) -> None:
    config = arm_config(arm)
    settings = config.recorder.model_copy(update={"compression": "none", "chunk_bytes": 4096})
    parts = Parts(config.model_copy(update={"recorder": settings}), tmp_path)
    sink = RecorderSink(parts.open(), lambda *_: None, parts=parts.open, part_bytes=65536)
    feed(sink, 0, 300, size=1000)
    sink.close()
    files = parts_of(tmp_path / "recording_0001.mcap")
    assert len(files) > 3
    assert max(path.stat().st_size for path in files) < 65536 + 32768  # a chunk and the rest
    assert numbers(files) == list(range(300))


def test_stamps_that_overlap_between_parts_come_in_order(arm: ArmProject, tmp_path: Path) -> None:
    parts = Parts(arm_config(arm), tmp_path)
    for stamps in ((10, 30), (20, 40)):
        writer = parts.open()
        for t_ns in stamps:
            writer.traffic(SerialTraffic("imu", [ByteChunk(t_ns, b"x")]))
        writer.close()
    files = parts_of(tmp_path / "recording_0001.mcap")
    assert [record.t_ns for record in messages_of(files, [TOPIC])] == [10, 20, 30, 40]


def test_a_writer_that_died_is_followed_by_the_next_part(arm: ArmProject, tmp_path: Path) -> None:
    """What was flushed is read from the broken part, and the rest from the new one."""
    config = arm_config(arm)
    first = Parts(config, tmp_path)
    sink = RecorderSink(first.open(), lambda *_: None)
    feed(sink, 0, 31)
    sink._writer._file.flush()
    broken = (tmp_path / "recording_0001.mcap").read_bytes()
    again = RecorderSink(Parts(config, tmp_path, resume=True).open(), lambda *_: None)
    feed(again, 40, 10)
    again.close()
    sink.close()
    (tmp_path / "recording_0001.mcap").write_bytes(broken)
    files = parts_of(tmp_path / "recording_0001.mcap")
    assert len(files) == 2
    found = numbers(files)
    assert found[-10:] == list(range(40, 50))
    assert found[:-10] == list(range(len(found) - 10))
    assert len(found) - 10 >= 21  # a chunk is finished every second, ten chunks a second
    assert contents_of(files).truncated
    assert newest_part(tmp_path) == (tmp_path / "recording_0001.mcap", 2)
    another = Parts(config, tmp_path).open()
    another.close()
    assert another.path.name == "recording_0002.mcap"


def record(arm: ArmProject, folder: Path, parts: int, **words: bool) -> list[Path]:
    """Write so many parts of a recording; return their paths."""
    opened = Parts(arm_config(arm), folder, **words)
    paths = []
    for _ in range(parts):
        writer = opened.open()
        writer.traffic(SerialTraffic("imu", [ByteChunk(0, b"x")]))
        writer.close()
        paths.append(writer.path)
    return paths


def test_the_number_of_a_deleted_recording_is_not_used_again(
    arm: ArmProject, tmp_path: Path
) -> None:
    assert names(record(arm, tmp_path, 1)) == ["recording_0001.mcap"]
    for path in record(arm, tmp_path, 2):
        path.unlink()
    assert names(record(arm, tmp_path, 1)) == ["recording_0003.mcap"]
    (tmp_path / ".last_recording").unlink()  # then it follows the highest there is
    assert names(record(arm, tmp_path, 1)) == ["recording_0004.mcap"]
    (tmp_path / ".last_recording").write_text("damaged")
    assert names(record(arm, tmp_path, 1)) == ["recording_0005.mcap"]


def test_a_part_of_another_recording_is_refused(arm: ArmProject, tmp_path: Path) -> None:
    """An old part whose first file is gone, as recordings were numbered before."""
    old, new = tmp_path / "old", tmp_path / "new"
    _, stale = record(arm, old, 2)
    (first,) = record(arm, new, 1)
    stale.rename(new / stale.name)
    with pytest.raises(ConfigError, match=r"recording_0001_0002.mcap: is not a part of"):
        parts_of(first)


def test_a_service_that_finds_a_damaged_newest_part_begins_a_recording_of_its_own(
    arm: ArmProject, tmp_path: Path
) -> None:
    (path,) = record(arm, tmp_path, 1)
    path.write_bytes(b"no recording")
    assert names(record(arm, tmp_path, 2, resume=True)) == [
        "recording_0002.mcap",
        "recording_0002_0002.mcap",
    ]


def test_a_part_that_could_not_be_begun_leaves_no_file(arm: ArmProject, tmp_path: Path) -> None:
    parts = Parts(arm_config(arm), tmp_path / "recordings")
    with file_limit(100), pytest.raises(OSError, match="large"):
        parts.open()
    assert [path.name for path in (tmp_path / "recordings").iterdir()] == [".last_recording"]


@contextmanager
def file_limit(size: int) -> Iterator[None]:
    """Let no file of this process grow beyond a size, as a full disk would not."""
    held = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, held)


def test_when_the_disk_is_full_recording_stops_and_goes_on_with_the_space(
    arm: ArmProject, tmp_path: Path
) -> None:
    config = arm_config(arm)
    settings = config.recorder.model_copy(update={"compression": "none", "chunk_bytes": 4096})
    parts = Parts(config.model_copy(update={"recorder": settings}), tmp_path)
    told: list[str] = []
    sink = RecorderSink(parts.open(), lambda _s, code, _t: told.append(code), parts=parts.open)
    attempts = 3 * RETRY_NS // (100 * MS)
    count = 0
    with file_limit(65536):
        while not told:
            feed(sink, count, 1)
            count += 1
        lost = sink.lost
    with file_limit(100):  # nothing at all can be written
        feed(sink, count, attempts)
    assert told == ["DISK_FULL"]
    assert sink.lost == lost + 2 * attempts
    feed(sink, count + attempts, 100)
    assert told == ["DISK_FULL", "RECORDER_BACK"]
    sink.close()
    files = parts_of(tmp_path / "recording_0001.mcap")
    found = numbers(files)
    assert len(files) == 2
    assert found[-1] == count + attempts + 99
    kept = [k for k in found if k < count]
    assert kept == list(range(len(kept)))  # all that was in finished chunks
    assert 500 * len(kept) > 65536 - 2 * 4096 - 15_000  # less chunks in progress and attachments
