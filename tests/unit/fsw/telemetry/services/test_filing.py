"""Files: named by folder, never outside, listed, copied, removed, sent down."""

import os
import zlib
from pathlib import Path

import pytest

from file_delivery.entity import FileEntity
from file_delivery.errors import DeliveryError
from file_delivery.library import DAEMON, GROUND, Pair
from file_delivery.transfer import Transfer, TransferState
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.services.long_work import PIECES_PER_POLL
from tests.support.application_cases import BEGUN, DONE, Flight

FILE, FOLDER, OTHER = 0, 1, 2


class FakeDelivery:
    def __init__(self) -> None:
        self.sent: list[tuple[Path, bool, str, tuple[int, int] | None]] = []
        self.under_way: list[Transfer] = []
        self.acted: list[tuple[str, tuple[int, int]]] = []
        self.ended: list[tuple[int, bool, str]] = []
        self.error = ""

    def send(self, path: Path, *, remove: bool, name: str = "", piece=None) -> int:
        if self.error:
            raise DeliveryError(self.error, "no")
        self.sent.append((path, remove, name, piece))
        return len(self.sent)

    def transfers(self):
        return self.under_way

    def cancel(self, key) -> None:
        self._act("cancel", key)

    def suspend(self, key) -> None:
        self._act("suspend", key)

    def resume(self, key, now_ns) -> None:  # noqa: ARG002
        self._act("resume", key)

    def _act(self, name: str, key) -> None:
        if key not in [item.key for item in self.under_way]:
            raise DeliveryError("FILE_NOT_FOUND", "no transfer")
        self.acted.append((name, key))

    def receive(self, pdu, now_ns) -> None: ...

    def poll(self, now_ns) -> list[bytes]:  # noqa: ARG002
        return []

    def finished(self):
        ended, self.ended = self.ended, []
        return ended

    def counters(self):
        return {}


@pytest.fixture
def files(flight: Flight) -> Path:
    state = flight.config.resolve(flight.config.service.state_directory)
    folder = state / "files"
    (folder / "a.txt").write_bytes(b"hello")
    (folder / "sub").mkdir()
    recordings = flight.config.resolve(flight.config.recorder.directory)
    recordings.mkdir()
    (recordings / "recording_0001.mcap").write_bytes(b"recorded")
    (state / "secret.key").write_bytes(bytes(32))
    (state / "events.jsonl").write_bytes(b"{}\n")
    return folder


def listed(flight: Flight, path: str, first: int = 1) -> list[tuple[object, ...]]:
    before = len(flight.all("file_entry"))
    flight.send("LIST_FILES", {"path": path, "first": first})
    flight.wait(0.3)
    names = ("entry", "entries", "kind", "path", "size_bytes")
    return [tuple(told[name] for name in names) for told in flight.all("file_entry")[before:]]


def test_a_folder_is_listed(flight: Flight, files: Path):
    (files / "b.txt").write_bytes(b"xy")
    (files / "loop").symlink_to(files / "loop")
    (files / ".incoming-2-7").write_bytes(b"not yet a file")
    assert listed(flight, "files") == [
        (1, 4, FILE, "files/a.txt", 5),
        (2, 4, FILE, "files/b.txt", 2),
        (3, 4, OTHER, "files/loop", 0),
        (4, 4, FOLDER, "files/sub", 0),
    ]
    assert listed(flight, "files/sub") == [(0, 0, FILE, "files/sub", 0)]


def test_a_name_that_is_no_utf_8_is_listed_with_an_escape(flight: Flight, files: Path):
    Path(os.fsdecode(os.fsencode(files) + b"/b\xff.txt")).write_bytes(b"xy")
    assert listed(flight, "files")[1] == (2, 3, FILE, "files/b\\udcff.txt", 2)


def test_a_folder_of_many_files_is_listed_page_by_page(flight: Flight, files: Path):
    names = [f"files/sub/f{k:03d}" for k in range(300)]
    for name in names:
        (files.parent / name).touch()
    found, first = [], 1
    while first <= 300:
        page = listed(flight, "files/sub", first)
        assert {entry[1] for entry in page} == {300}, "an operator sees that there is more"
        assert len(page) <= 64
        found += [entry[3] for entry in page]
        first += len(page)
    assert found == names
    assert listed(flight, "files/sub", 301) == [(0, 300, FILE, "files/sub", 0)]


def test_a_long_list_is_sent_piece_by_piece_while_other_telecommands_run(
    flight: Flight, files: Path
):
    for k in range(2 * PIECES_PER_POLL):
        (files / f"{k:03d}").touch()
    assert flight.send("LIST_FILES", {"path": "files", "first": 1})[:2] == BEGUN
    assert len(flight.all("file_entry")) == PIECES_PER_POLL
    assert "alive" in flight.send("PING")
    assert flight.refused("LIST_FILES", {"path": "files", "first": 1}) is Error.BUSY
    flight.wait(0.1)
    assert len(flight.all("file_entry")) == 2 * PIECES_PER_POLL
    flight.wait(0.1)
    assert flight.packets[-1].packet.name == "completion_success"


@pytest.mark.parametrize("path", ["files/loop", "files/loop/a", "files/to_root/etc/passwd"])
def test_links_that_lead_nowhere_or_outside_name_nothing(flight: Flight, files: Path, path):
    (files / "loop").symlink_to(files / "loop")
    (files / "to_root").symlink_to("/")
    for name in ("REPORT_FILE_ATTRIBUTES", "DELETE_DIRECTORY", "CREATE_DIRECTORY"):
        assert flight.refused(name, {"path": path}) in (Error.BAD_ARG, Error.FILE_NOT_FOUND)
    assert flight.refused("LIST_FILES", {"path": path, "first": 1}) is Error.BAD_ARG


def test_files_and_folders_are_made_renamed_and_removed(flight: Flight, files: Path):
    assert flight.send("CREATE_DIRECTORY", {"path": "files/new"}) == DONE
    assert flight.refused("CREATE_DIRECTORY", {"path": "files/new"}) is Error.BUSY
    move = {"path": "files/a.txt", "target": "files/new/b.txt"}
    assert flight.send("MOVE_FILE", move) == DONE
    assert (files / "new" / "b.txt").read_bytes() == b"hello"
    assert flight.refused("MOVE_FILE", move) is Error.BUSY
    folder = {"path": "files/new", "target": "files/old"}
    assert flight.refused("MOVE_FILE", folder) is Error.FILE_NOT_FOUND
    assert flight.send("RENAME_DIRECTORY", folder) == DONE
    flight.send("DELETE_DIRECTORY", {"path": "files/old"})
    assert flight.error() is Error.FAILED, "it is not empty"
    flight.send("DELETE_FILE", {"path": "files/old/b.txt"})
    assert flight.send("DELETE_DIRECTORY", {"path": "files/old"}) == DONE
    assert not (files / "old").exists()


@pytest.mark.parametrize("path", ["files", "recordings", "events.jsonl", "files/.hidden"])
def test_the_folders_themselves_and_hidden_names_are_not_touched(flight: Flight, files: Path, path):
    (files / ".hidden").touch()
    for name in ("DELETE_FILE", "DELETE_DIRECTORY", "CREATE_DIRECTORY"):
        assert flight.refused(name, {"path": path}) is Error.BAD_ARG
    target = {"path": "files/a.txt", "target": path}
    assert flight.refused("MOVE_FILE", target) is Error.BAD_ARG
    assert flight.refused("APPEND_FILE", target | {"offset": 0}) is Error.BAD_ARG


def test_pieces_are_appended_where_they_fit(flight: Flight, files: Path):
    for piece, offset in ((b"hello", 0), (b" world", 5)):
        (files / "piece").write_bytes(piece)
        given = {"path": "files/piece", "target": "files/whole", "offset": offset}
        assert flight.send("APPEND_FILE", given) == DONE
        assert not (files / "piece").exists()
    assert (files / "whole").read_bytes() == b"hello world"
    (files / "piece").write_bytes(b"again")
    assert flight.refused("APPEND_FILE", given) is Error.OUT_OF_RANGE, "it is there already"
    assert (files / "whole").read_bytes() == b"hello world"


def test_free_space_is_reported(flight: Flight, files: Path):  # noqa: ARG001
    flight.send("REPORT_FREE_SPACE")
    told = flight.all("file_space")
    assert [item["path"] for item in told] == ["files", "recordings"]
    assert all(0 < item["free_bytes"] <= item["total_bytes"] for item in told)


def test_transfers_are_reported_suspended_resumed_and_aborted(flight: Flight):
    delivery = FakeDelivery()
    flight.app.transfers.delivery = delivery
    flight.send("REPORT_TRANSFERS")
    assert flight.last("transfer_status")["entries"] == 0
    key = (2, (1 << 60) + 1)
    delivery.under_way = [Transfer(key, "up.bin", 100, 40, TransferState.RECEIVING, 0)]
    flight.send("REPORT_TRANSFERS")
    told = flight.last("transfer_status")
    assert (told["entry"], told["entries"], told["path"]) == (1, 1, "up.bin")
    assert (told["source"], told["number"]) == key
    assert (told["size_bytes"], told["done_bytes"]) == (100, 40)
    given = {"source": key[0], "number": key[1]}
    for name in ("SUSPEND_TRANSFER", "RESUME_TRANSFER", "ABORT_TRANSFER"):
        assert flight.send(name, given) == DONE
    assert delivery.acted == [("suspend", key), ("resume", key), ("cancel", key)]
    flight.send("ABORT_TRANSFER", given | {"source": 1})
    assert flight.error() is Error.FILE_NOT_FOUND


def test_a_piece_of_a_file_goes_down(flight: Flight, files: Path):
    delivery = FakeDelivery()
    flight.app.transfers.delivery = delivery
    given = {"path": "files/a.txt", "offset": 1, "size_bytes": 4, "name": "piece-1"}
    assert flight.send("DOWNLINK_PIECE", given) == BEGUN
    assert delivery.sent == [(files / "a.txt", False, "piece-1", (1, 4))]
    assert flight.refused("DOWNLINK_PIECE", given | {"offset": 2}) is Error.OUT_OF_RANGE


def test_attributes(flight: Flight, files: Path):  # noqa: ARG001
    flight.send("REPORT_FILE_ATTRIBUTES", {"path": "files/a.txt"})
    told = flight.last("file_attributes")
    assert (told["size_bytes"], told["crc32"]) == (5, zlib.crc32(b"hello"))
    flight.send("REPORT_FILE_ATTRIBUTES", {"path": "events.jsonl"})
    assert flight.last("file_attributes")["size_bytes"] == 3


def test_files_are_copied_and_removed(flight: Flight, files: Path):
    copy = {"path": "files/a.txt", "target": "files/sub/c.txt"}
    assert flight.send("COPY_FILE", copy) == DONE
    assert (files / "sub" / "c.txt").read_bytes() == b"hello"
    assert flight.refused("COPY_FILE", copy) is Error.BUSY
    assert flight.send("DELETE_FILE", {"path": "files/a.txt"}) == DONE
    assert not (files / "a.txt").exists()


@pytest.mark.parametrize(
    "path", ["/etc/passwd", "secret.key", "files/../secret.key", "state/secret.key", "files/link"]
)
def test_nothing_outside_can_be_named(flight: Flight, files: Path, path):
    (files / "link").symlink_to(files.parent / "secret.key")
    assert flight.refused("REPORT_FILE_ATTRIBUTES", {"path": path}) is Error.BAD_ARG
    assert flight.refused("DOWNLINK_FILE", {"path": path, "remove": 0}) is Error.BAD_ARG
    assert flight.refused("COPY_FILE", {"path": "files/a.txt", "target": path}) is Error.BAD_ARG


def test_logs_go_down_but_are_not_removed(flight: Flight, files: Path):  # noqa: ARG001
    assert flight.refused("DELETE_FILE", {"path": "events.jsonl"}) is Error.BAD_ARG
    assert flight.refused("DOWNLINK_FILE", {"path": "events.jsonl", "remove": 1}) is Error.BAD_ARG


def test_the_recording_in_progress_is_not_removed_nor_sent_until_it_is_closed(
    flight: Flight, files: Path
):
    flight.app.transfers.delivery = FakeDelivery()
    flight.recording.path = files.parent.parent / "recordings" / "recording_0001.mcap"
    flight.send("REC_START")
    path = {"path": "recordings/recording_0001.mcap"}
    assert flight.refused("DELETE_FILE", path) is Error.BUSY
    assert flight.refused("DOWNLINK_FILE", path | {"remove": 0}) is Error.BUSY
    flight.send("REC_STOP")
    assert flight.send("DOWNLINK_FILE", path | {"remove": 0}) == BEGUN
    assert flight.send("DELETE_FILE", path) == DONE


def test_a_file_goes_down_and_completes_when_it_has_arrived(flight: Flight, files: Path):
    delivery = FakeDelivery()
    flight.app.transfers.delivery = delivery
    assert flight.send("DOWNLINK_FILE", {"path": "files/a.txt", "remove": 0}) == BEGUN
    assert delivery.sent == [(files / "a.txt", False, "", None)]
    delivery.ended = [(1, True, "a.txt")]
    flight.wait(0.1)
    assert "completion_success" in [p.packet.name for p in flight.packets]
    assert flight.codes[-2:] == ["FILE_SENT", "TC_COMPLETED"]
    flight.send("DOWNLINK_FILE", {"path": "files/a.txt", "remove": 0})
    delivery.ended = [(2, False, "gave up")]
    flight.wait(0.1)
    assert flight.error() is Error.TIMEOUT
    delivery.error = "BUSY"
    flight.send("DOWNLINK_FILE", {"path": "files/a.txt", "remove": 0})
    assert flight.error() is Error.BUSY


def test_a_recording_is_removed_when_it_has_arrived(flight: Flight, files: Path):
    recording = flight.config.resolve(flight.config.recorder.directory) / "recording_0001.mcap"
    flight.send("DOWNLINK_FILE", {"path": "recordings/recording_0001.mcap", "remove": 1})
    ends = Pair(here=GROUND, there=DAEMON)
    (files.parent / "ground").mkdir()
    ground = FileEntity(files.parent / "ground", ends=ends)
    for _ in range(10):
        for unit in flight.app.transfers.delivery.poll(0):
            ground.receive(unit, 0)
        for unit in ground.poll(0):
            flight.app.transfers.delivery.receive(unit, 0)
    assert (files.parent / "ground" / "recording_0001.mcap").read_bytes() == b"recorded"
    assert not recording.exists()


def test_a_file_that_comes_up_is_told(flight: Flight):
    delivery = FakeDelivery()
    flight.app.transfers.delivery = delivery
    delivery.ended = [(0, True, "noise.yaml")]
    flight.wait(0.1)
    assert flight.codes[-1] == "FILE_RECEIVED"


def test_a_loop_of_links_is_no_file_and_ends_nothing(flight: Flight, files: Path):
    (files / "a").symlink_to(files / "b")
    (files / "b").symlink_to(files / "a")
    for name, more in (
        ("REPORT_FILE_ATTRIBUTES", {}),
        ("LIST_FILES", {"first": 1}),
        ("DELETE_FILE", {}),
    ):
        assert flight.refused(name, {"path": "files/a"} | more) is Error.BAD_ARG
    assert [entry[2:4] for entry in listed(flight, "files")] == [
        (OTHER, "files/a"),
        (FILE, "files/a.txt"),
        (OTHER, "files/b"),
        (FOLDER, "files/sub"),
    ]


OTHERS = ["command.key", "config.yaml", ".last_recording", "state", "state/boot", "x.mcap"]


@pytest.mark.parametrize("name", OTHERS)
def test_only_the_recorders_own_files_have_names_among_the_recordings(flight, files, name):
    recordings = files.parent.parent / "recordings"
    other = recordings / name
    other.parent.mkdir(exist_ok=True)
    other.write_bytes(b"not for the ground")
    told = f"recordings/{name}"
    flight.send("COPY_FILE", {"path": told, "target": "files/stolen"})
    assert flight.error() is Error.BAD_ARG
    flight.send("MOVE_FILE", {"path": told, "target": "files/stolen"})
    flight.send("MOVE_FILE", {"path": "files/a.txt", "target": told})
    flight.send("DELETE_FILE", {"path": told})
    flight.send("DOWNLINK_FILE", {"path": told, "remove": 1})
    flight.send("CREATE_DIRECTORY", {"path": "recordings/sub"})
    flight.wait(0.3)
    assert other.read_bytes() == b"not for the ground"
    assert not (files / "stolen").exists()
    assert not (recordings / "sub").exists()
    shown = [str(value) for entry in listed(flight, "recordings") for value in entry]
    assert [text for text in shown if "/" in text] == ["recordings/recording_0001.mcap"]
