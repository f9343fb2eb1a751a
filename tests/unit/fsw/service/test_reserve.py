"""Recordings, uploads, copies and blocks leave the reserve of a disk to what must be kept."""

import os
import shutil
from pathlib import Path

import pytest

from file_delivery.entity import FileEntity
from file_delivery.room import LEAST_INODES
from fsw.drivers.wire import ByteChunk
from fsw.exchange.recording import messages
from fsw.exchange.sinks import SerialTraffic, StatusReport
from fsw.service.blockstore import BlockWriter
from fsw.service.recorder import Parts, RecorderSink
from fsw.telemetry.services.file_pieces import append, copy
from fsw.telemetry.state.journal import Journal
from tests.conftest import ArmProject
from tests.support.delivery_cases import Uplink, drain
from tests.support.loop_cases import arm_config, make_block
from tests.support.small_disk import BALLAST, fill, small_disk

DISK_BYTES, RESERVE_BYTES = 4 << 20, 1 << 20
MS = 10**6


def free_bytes(disk: Path) -> int:
    room = os.statvfs(disk)
    return room.f_bavail * room.f_frsize


@pytest.fixture
def disk(tmp_path):
    with small_disk(tmp_path / "disk", DISK_BYTES, 64) as folder:
        yield folder


class Recorder:
    """A recorder on a disk, and what it was given and has told."""

    def __init__(self, arm: ArmProject, disk: Path) -> None:
        arm.data["service"]["disk_reserve_bytes"] = RESERVE_BYTES
        arm.data["recorder"]["compression"] = "none"
        config = arm_config(arm)
        self.told: list[str] = []
        self.given = 0
        parts = Parts(config, disk / "recordings")
        self.sink = RecorderSink(
            parts.open(),
            lambda _severity, code, _text: self.told.append(code),
            parts=parts.open,
            has_room=parts.has_room,
        )

    def feed(self, count: int, size: int = 2000) -> None:
        for _ in range(count):
            t_ns = self.given * 50 * MS
            data = self.given.to_bytes(4, "big") + bytes(size)
            self.sink.put(SerialTraffic("imu", [ByteChunk(t_ns, data)]))
            self.sink.put(StatusReport(t_ns, {}))
            self.sink.sync()
            self.given += 1


def recorded(disk: Path) -> list[int]:
    files = sorted((disk / "recordings").glob("*.mcap"))
    found = [record for path in files for record in messages(path, ["/serial/imu"])]
    return sorted(int.from_bytes(record.data[:4], "big") for record in found)


def test_a_recording_stops_at_the_reserve_and_loses_only_what_it_counts(arm, disk):
    recorder = Recorder(arm, disk)
    recorder.feed(3000)
    assert recorder.told == ["DISK_FULL"]
    assert "reserve" in recorder.sink.failing
    assert free_bytes(disk) > 0.9 * RESERVE_BYTES
    found = recorded(disk)
    assert found == list(range(len(found)))
    lost = recorder.sink.lost  # traffic and status
    assert 2 * (recorder.given - len(found)) - 1 <= lost <= 2 * (recorder.given - len(found))
    shutil.copy(disk / "recordings" / "recording_0001.mcap", disk.parent / "kept.mcap")
    (disk / "recordings" / "recording_0001.mcap").unlink()
    recorder.feed(40)
    recorder.sink.close()
    assert recorder.told == ["DISK_FULL", "RECORDER_BACK"]
    assert recorder.sink.failing == ""
    assert recorded(disk)[-1] == recorder.given - 1


def test_a_disk_that_others_fill_at_once_loses_only_what_is_counted(arm, disk):
    recorder = Recorder(arm, disk)
    recorder.feed(500)
    fill(disk)
    recorder.feed(40)
    assert recorder.told == ["DISK_FULL"]
    kept = len(recorded(disk))
    assert kept > 400
    assert 2 * (recorder.given - kept) <= recorder.sink.lost + 1


def test_an_upload_leaves_the_reserve(disk):
    folder = disk / "files"
    folder.mkdir()
    fill(disk)
    os.truncate(disk / BALLAST, (disk / BALLAST).stat().st_size - RESERVE_BYTES - (1 << 16))
    size_of_piece = 1 << 14
    for size, is_stated, arrives in (
        (1 << 17, True, False),
        (1 << 17, False, False),
        (1 << 14, True, True),
    ):
        uplink = Uplink(bytes(size))
        uplink.size = size if is_stated else 0
        entity = FileEntity(folder, reserve_bytes=RESERVE_BYTES)
        entity.receive(uplink.metadata(), 0)
        for start in range(0, size, size_of_piece):
            entity.receive(uplink.data(start, start + size_of_piece), 0)
        assert free_bytes(disk) >= RESERVE_BYTES - 4096
        uplink.size = size
        entity.receive(uplink.end(), 0)
        drain(entity)
        assert [good for _, good, _ in entity.finished()] == [arrives]


def test_copies_and_appended_files_leave_the_reserve(disk):
    (disk / "a").write_bytes(bytes(1 << 20))
    (disk / "b").write_bytes(bytes(1 << 10))
    list(copy(disk / "a", disk / "c", RESERVE_BYTES))
    with pytest.raises(OSError, match="No space left"):
        list(copy(disk / "a", disk / "d", RESERVE_BYTES))
    assert not (disk / "d").exists()
    fill(disk)
    with pytest.raises(OSError, match="No space left"):
        list(append(disk / "a", disk / "b", 1 << 10, RESERVE_BYTES))
    assert (disk / "b").stat().st_size == 1 << 10
    assert (disk / "a").exists()


def test_blocks_that_do_not_fit_leave_no_file(disk):
    writer = BlockWriter(disk / "blocks.bin", reserve_bytes=RESERVE_BYTES)
    with pytest.raises(OSError, match="No space left"):
        writer.append(make_block(0))
    assert list(disk.iterdir()) == []


def test_logs_leave_half_of_the_reserve_and_count_what_they_lose(disk):
    journal = Journal(disk / "log", 1 << 30, RESERVE_BYTES // 2)
    for k in range(5000):
        journal.append({"k": k, "text": "x" * 1000})
    assert free_bytes(disk) >= RESERVE_BYTES // 2 - 4096
    assert len(journal.read()) + journal.lost == 5000
    assert journal.lost > 0


def test_new_files_leave_some_inodes(arm, disk):
    for k in range(64):
        try:
            (disk / str(k)).touch()
        except OSError:
            break
    (disk / "0").unlink()
    for k in range(1, LEAST_INODES):
        (disk / str(k)).unlink()
    with pytest.raises(OSError, match="No space left"):
        Parts(arm_config(arm), disk).open()
