"""Files that grow are on the disk within two seconds, and a slow disk holds nobody up."""

import os
import threading
from pathlib import Path

import pytest

from fsw.clock import MonotonicClock
from fsw.exchange.ring import RingReader, RingWriter
from fsw.messages import Event
from fsw.service.disk_sync import PERIOD_NS, DiskSync
from fsw.service.process import Service
from fsw.telemetry.state.journal import Journal
from tests.conftest import ArmProject
from tests.support.application_cases import flight_config


class Disk:
    """Notes what is brought to it; may be slow or broken."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.synced: list[Path] = []
        self.broken: set[Path] = set()
        self.free = threading.Event()
        self.free.set()
        self.asked = threading.Semaphore(0)
        self._sync = os.fsync
        monkeypatch.setattr(os, "fsync", self)

    def __call__(self, descriptor: int) -> None:
        path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        self.asked.release()
        assert self.free.wait(60.0)
        if path in self.broken:
            raise OSError(5, "Input/output error")
        self._sync(descriptor)
        self.synced.append(path)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)


def finished(sync: DiskSync) -> None:
    """Wait for the round that is under way."""
    assert sync._running is not None
    sync._running.exception(60.0)


def test_files_and_their_folders_come_to_the_disk_each_period(tmp_path: Path, disk: Disk):
    journal = Journal(tmp_path / "log.jsonl", 1 << 20)
    failures: list[str] = []
    sync = DiskSync(lambda: [*journal.files, tmp_path / "missing"], failures.append)
    journal.append({"a": 1})
    sync.poll(0)
    finished(sync)
    assert disk.synced == [tmp_path / "log.jsonl", tmp_path]
    sync.poll(PERIOD_NS - 1)
    assert len(disk.synced) == 2
    sync.poll(PERIOD_NS)
    finished(sync)
    assert len(disk.synced) == 4
    sync.close()
    assert len(disk.synced) == 6
    assert failures == []


def test_a_slow_disk_holds_nobody_up_and_gets_no_second_round(tmp_path: Path, disk: Disk):
    path = tmp_path / "log"
    path.touch()
    sync = DiskSync(lambda: [path], lambda _: None)
    disk.free.clear()
    sync.poll(0)
    assert disk.asked.acquire(timeout=60.0)
    for k in range(1, 100):
        sync.poll(k * PERIOD_NS)  # would wait here for ever
    assert disk.synced == []
    disk.free.set()
    finished(sync)
    assert disk.synced == [path, tmp_path]
    sync.close()


def test_a_failure_is_reported_once_and_the_other_files_are_not_left_out(
    tmp_path: Path, disk: Disk
):
    first, second = tmp_path / "first", tmp_path / "second"
    first.touch()
    second.touch()
    disk.broken = {first}
    failures: list[str] = []
    sync = DiskSync(lambda: [first, second], failures.append)
    for k in range(4):
        sync.poll(k * PERIOD_NS)
        finished(sync)
    assert failures == [f"[Errno 5] Input/output error: '{first}'"]
    assert disk.synced.count(second) == 4
    disk.broken = set()
    sync.poll(4 * PERIOD_NS)
    finished(sync)
    disk.broken = {second}
    for k in range(5, 8):
        sync.poll(k * PERIOD_NS)
        finished(sync)
    assert len(failures) == 2, "a new failure is a new report"
    sync.close()


def test_the_service_brings_recording_and_logs_to_the_disk(arm: ArmProject, disk: Disk):
    config = flight_config(arm)
    state = config.resolve(config.service.state_directory)
    down, found, up = (RingWriter.create(1 << 20) for _ in range(3))
    inbox = RingReader(os.dup(down.fd)), RingReader(os.dup(found.fd))
    service = Service(config, MonotonicClock(), *inbox, up, resume=False)
    service.open()
    for code in ("TC_GARBAGE", "STOPPED"):
        service.event(Event(1, "low", code, ""))
    recording = service._switch.path
    service.cycle()
    finished(service._disk)
    wanted = {state / "events.jsonl", state / "security.jsonl", recording, state}
    wanted.add(state / "packet_stores/events/00000001.packets")
    assert wanted <= set(disk.synced)
    service.close()
    assert wanted <= set(disk.synced[len(disk.synced) // 2 :]), "once more at the end"
