"""Transfers in pieces: continued after an interruption, and given up with a reason."""

import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from ground import files
from ground.delivery import EndedError, Facts, RefusedError, facts_of
from ground.errors import GroundError, LinkError, UsageError
from ground.files import ProgressLines
from ground.transfers import Records, ResumableTransfer, SpoiledError, TransferRecord, carry_on

PIECE = 1000


@dataclass
class FakeDelivery:
    """The daemon's folders, on a link that breaks when told to."""

    is_heard = True
    folder: Path
    breaks: list[int] = field(default_factory=list)  # before these calls
    calls: list[str] = field(default_factory=list)

    def _called(self, name: str) -> None:
        self.calls.append(name)
        if len(self.calls) in self.breaks:
            raise LinkError("cut")

    def facts(self, remote: str) -> Facts | None:
        self._called("facts")
        path = self.folder / remote
        return facts_of(path) if path.is_file() else None

    def fetch(self, remote: str, offset: int, size: int) -> bytes:
        self._called(f"fetch {offset}")
        data = (self.folder / remote).read_bytes()
        if offset + size > len(data):
            raise RefusedError("the daemon: OUT_OF_RANGE", 3, "OUT_OF_RANGE")
        return data[offset : offset + size]

    def store(self, local: Path, name: str, piece: tuple[int, int] | None = None) -> None:
        start, size = piece or (0, local.stat().st_size)
        self._called(f"store {start}")
        (self.folder / "files" / name).write_bytes(local.read_bytes()[start : start + size])

    def ask(self, name: str, **given: str) -> list[object]:
        self._called(name)
        path = self.folder / given["path"]
        if not path.exists():
            raise RefusedError(name, 3, "FILE_NOT_FOUND")
        if name == "DELETE_FILE":
            path.unlink()
            return []
        target = self.folder / given["target"]
        if name == "MOVE_FILE":
            assert not target.exists()
            path.rename(target)
        else:
            there = target.read_bytes() if target.exists() else b""
            assert (name, int(given["offset"])) == ("APPEND_FILE", len(there))
            target.write_bytes(there + path.read_bytes())
            path.unlink()
        return []


@pytest.fixture
def records(tmp_path) -> Records:
    return Records(tmp_path / "state")


@pytest.fixture
def daemon(tmp_path) -> FakeDelivery:
    (tmp_path / "daemon" / "files").mkdir(parents=True)
    return FakeDelivery(tmp_path / "daemon")


def content(size: int) -> bytes:
    return np.random.default_rng(size).bytes(size)


def start(
    direction: str, size: int, tmp_path: Path, daemon: FakeDelivery, records
) -> ResumableTransfer:
    remote, local = "files/a", tmp_path / "a"
    (local if direction == "put" else daemon.folder / remote).write_bytes(content(size))
    make = ResumableTransfer.put if direction == "put" else ResumableTransfer.get
    return make(remote, local, records, lambda _text: None, PIECE)


@pytest.mark.parametrize("direction", ["get", "put"])
@pytest.mark.parametrize("size", [0, 1, 999, 1000, 1001, 3500])
def test_a_file_arrives_whole_and_leaves_no_trace(tmp_path, daemon, records, direction, size):
    transfer = start(direction, size, tmp_path, daemon, records)
    assert transfer.run(daemon) == size
    assert (tmp_path / "a").read_bytes() == content(size)
    assert [p.name for p in (daemon.folder / "files").iterdir()] == ["a"]
    assert (daemon.folder / "files" / "a").read_bytes() == content(size)
    assert records.all() == []
    assert [p.name for p in tmp_path.glob(".*")] == []


@pytest.mark.parametrize("direction", ["get", "put"])
def test_a_program_killed_at_any_call_is_continued_with_the_next_piece(
    tmp_path, daemon, records, direction
):
    transfer = start(direction, 3500, tmp_path, daemon, records)
    (daemon.folder / "files" / "other").write_bytes(b"")
    through = {"get": 3, "put": 5}[direction]  # calls up to the one that breaks: one piece each
    runs = 0
    while records.all():
        runs += 1
        daemon.breaks = [len(daemon.calls) + through]
        again = ResumableTransfer(records.find(transfer.record.id), records, lambda _text: None)
        try:
            again.run(daemon)
        except LinkError:
            assert runs < 20
    name = "fetch" if direction == "get" else "store"
    moved = [c for c in daemon.calls if c.startswith(name)]
    assert {c.split()[1] for c in moved} == {"0", "1000", "2000", "3000"}
    assert (tmp_path / "a").read_bytes() == (daemon.folder / "files" / "a").read_bytes()
    assert records.all() == []


def test_pieces_that_have_come_are_not_fetched_again(tmp_path, daemon, records):
    transfer = start("get", 3500, tmp_path, daemon, records)
    daemon.breaks = [4]  # facts, fetch 0, fetch 1000, and the third is cut
    with pytest.raises(LinkError):
        transfer.run(daemon)
    with transfer.record.partial.open("ab") as file:
        file.write(b"half a piece, when the program was killed")
    transfer.run(daemon)
    assert [c for c in daemon.calls if c.startswith("fetch")] == [
        f"fetch {offset}" for offset in (0, 1000, 2000, 2000, 3000)
    ]
    assert (tmp_path / "a").read_bytes() == content(3500)


@pytest.mark.parametrize("direction", ["get", "put"])
def test_a_file_that_changed_since_is_not_continued(tmp_path, daemon, records, direction):
    transfer = start(direction, 3500, tmp_path, daemon, records)
    daemon.breaks = [4]
    with pytest.raises(LinkError):
        transfer.run(daemon)
    source = tmp_path / "a" if direction == "put" else daemon.folder / "files" / "a"
    source.write_bytes(content(3501))
    with pytest.raises(SpoiledError, match="has changed since"):
        transfer.run(daemon)
    transfer.discard(daemon)
    assert records.all() == []
    assert not transfer.record.partial.exists()
    assert sorted(p.name for p in (daemon.folder / "files").iterdir()) in (["a"], [])


def test_a_small_file_that_is_written_all_the_time_is_got_as_it_is(tmp_path, daemon, records):
    transfer = start("get", 900, tmp_path, daemon, records)
    truth, fetch = daemon.folder / "files" / "a", daemon.fetch

    def changing(remote: str, offset: int, size: int) -> bytes:
        if len(daemon.calls) < 4:
            truth.write_bytes(content(500))
        return fetch(remote, offset, size)

    daemon.fetch = changing
    transfer.run(daemon)
    assert (tmp_path / "a").read_bytes() == content(500)


def test_an_upload_replaces_the_old_file_only_when_it_is_whole(tmp_path, daemon, records):
    (daemon.folder / "files" / "a").write_bytes(b"old")
    transfer = start("put", 3500, tmp_path, daemon, records)
    daemon.breaks = [7]
    with pytest.raises(LinkError):
        transfer.run(daemon)
    assert (daemon.folder / "files" / "a").read_bytes() == b"old"
    transfer.run(daemon)
    assert (daemon.folder / "files" / "a").read_bytes() == content(3500)


def test_a_damaged_upload_is_not_given_its_name(tmp_path, daemon, records):
    transfer = start("put", 3500, tmp_path, daemon, records)
    daemon.breaks = [4]
    with pytest.raises(LinkError):
        transfer.run(daemon)
    (daemon.folder / transfer.record.uploaded).write_bytes(content(1000)[::-1])
    with pytest.raises(SpoiledError, match="not what was sent"):
        transfer.run(daemon)
    assert not (daemon.folder / "files" / "a").exists()


def test_a_missing_file_is_refused_with_its_name(tmp_path, daemon, records):
    transfer = ResumableTransfer.get(
        "files/none", tmp_path / "x", records, lambda _text: None, PIECE
    )
    with pytest.raises(RefusedError, match="files/none: no such file"):
        transfer.run(daemon)
    assert not transfer.is_worth_keeping
    with pytest.raises(UsageError, match="no such file"):
        ResumableTransfer.put("b", tmp_path / "none", records, lambda _text: None, PIECE)


def test_records_that_are_damaged_are_left_alone(tmp_path, daemon, records):
    transfer = start("put", 10, tmp_path, daemon, records)
    (tmp_path / "state" / "bad.json").write_text("{")
    (tmp_path / "state" / "other.json").write_text('{"id": 1}')
    assert records.all() == [transfer.record]
    with pytest.raises(UsageError, match="no such transfer"):
        records.find("bad")
    assert isinstance(records.find(transfer.record.id), TransferRecord)


def test_a_lost_link_is_waited_for_and_a_refusal_is_not(daemon):
    fates: list[GroundError | None] = [LinkError("cut"), LinkError("refused"), None]
    told: list[str] = []

    @contextmanager
    def connect():
        yield daemon

    def work(_delivery) -> int:
        fate = fates.pop(0)
        if fate is not None:
            raise fate
        return 7

    assert carry_on(connect, work, time.monotonic() + 60.0, 60.0, told.append) == 7
    assert told == ["cut; trying again", "refused; trying again"]
    fates[:] = [EndedError("no"), None]
    with pytest.raises(EndedError):
        carry_on(connect, work, time.monotonic() + 60.0, 60.0, told.append)
    fates[:] = [LinkError("cut"), None]
    with pytest.raises(LinkError):
        carry_on(connect, work, time.monotonic(), 60.0, told.append)


def test_a_daemon_that_is_gone_is_not_waited_for_until_the_time_of_the_transfer_is_over():
    tried: list[float] = []

    @contextmanager
    def connect():
        tried.append(time.monotonic())
        raise LinkError("refused")
        yield

    with pytest.raises(LinkError, match="refused"):
        carry_on(connect, lambda _delivery: 0, time.monotonic() + 600.0, 2.5, lambda _text: None)
    assert len(tried) > 1
    assert tried[-1] - tried[0] <= 2.5


def test_a_daemon_that_accepts_connections_and_never_answers_is_left_as_well(daemon):
    daemon.is_heard = False
    tried: list[float] = []

    @contextmanager
    def connect():
        tried.append(time.monotonic())
        yield daemon

    def work(_delivery) -> int:
        raise LinkError("no answer")

    with pytest.raises(LinkError, match="no answer"):
        carry_on(connect, work, time.monotonic() + 600.0, 2.5, lambda _text: None)
    assert len(tried) > 1
    assert tried[-1] - tried[0] <= 2.5


def test_progress_without_a_terminal_is_a_line_at_times(capsys, monkeypatch):
    told = ProgressLines()
    for text in ("a: 1 bytes", "a: 2 bytes"):
        told(text)
    assert capsys.readouterr().err == "ground: a: 1 bytes\n"
    monkeypatch.setattr(files, "EVERY_S", 0.0)
    told = ProgressLines()
    for text in ("cut; trying again", "a: 3 bytes"):
        told(text)
    assert capsys.readouterr().err == "ground: cut; trying again\nground: a: 3 bytes\n"
