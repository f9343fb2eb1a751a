"""Files: named by folder, never outside, listed, copied, removed, sent down."""

import zlib
from pathlib import Path

import pytest

from file_delivery.errors import DeliveryError
from fsw.telemetry.dictionary.codes import Error
from tests.support.application_cases import BEGUN, DONE, Flight


class FakeDelivery:
    def __init__(self) -> None:
        self.sent: list[tuple[Path, bool]] = []
        self.ended: list[tuple[int, bool, str]] = []
        self.error = ""

    def send(self, path: Path, *, remove: bool) -> int:
        if self.error:
            raise DeliveryError(self.error, "no")
        self.sent.append((path, remove))
        return len(self.sent)

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
    (recordings / "r.mcap").write_bytes(b"recorded")
    (state / "secret.key").write_bytes(bytes(32))
    (state / "events.jsonl").write_bytes(b"{}\n")
    return folder


def test_a_directory_is_listed(flight: Flight, files: Path):
    (files / "b.txt").write_bytes(b"xy")
    flight.send("LIST_FILES", {"path": "files"})
    told = flight.all("file_entry")
    assert [(t["entry"], t["entries"], t["path"], t["size_bytes"]) for t in told] == [
        (1, 2, "files/a.txt", 5),
        (2, 2, "files/b.txt", 2),
    ]
    flight.send("LIST_FILES", {"path": "files/sub"})
    assert flight.last("file_entry")["entries"] == 0


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
    flight.app.deliver_by(FakeDelivery())
    flight.recording.path = files.parent.parent / "recordings" / "r.mcap"
    flight.send("REC_START")
    path = {"path": "recordings/r.mcap"}
    assert flight.refused("DELETE_FILE", path) is Error.BUSY
    assert flight.refused("DOWNLINK_FILE", path | {"remove": 0}) is Error.BUSY
    flight.send("REC_STOP")
    assert flight.send("DOWNLINK_FILE", path | {"remove": 0}) == BEGUN
    assert flight.send("DELETE_FILE", path) == DONE


def test_a_file_goes_down_and_completes_when_it_has_arrived(flight: Flight, files: Path):
    delivery = FakeDelivery()
    flight.app.deliver_by(delivery)
    assert flight.send("DOWNLINK_FILE", {"path": "files/a.txt", "remove": 0}) == BEGUN
    assert delivery.sent == [(files / "a.txt", False)]
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


def test_a_recording_goes_down_under_a_second_name_and_is_removed_when_it_arrived(
    flight: Flight, files: Path
):
    delivery = FakeDelivery()
    flight.app.deliver_by(delivery)
    flight.send("DOWNLINK_FILE", {"path": "recordings/r.mcap", "remove": 1})
    assert delivery.sent == [(files / "outbox" / "r.mcap", True)]
    assert delivery.sent[0][0].read_bytes() == b"recorded"
    recording = flight.config.resolve(flight.config.recorder.directory) / "r.mcap"
    assert recording.exists()
    delivery.ended = [(1, True, "r.mcap")]
    flight.wait(0.1)
    assert not recording.exists()


def test_a_file_that_comes_up_is_told(flight: Flight):
    delivery = FakeDelivery()
    flight.app.deliver_by(delivery)
    delivery.ended = [(0, True, "noise.yaml")]
    flight.wait(0.1)
    assert flight.codes[-1] == "FILE_RECEIVED"


def test_a_loop_of_links_is_no_file_and_ends_nothing(flight: Flight, files: Path):
    (files / "a").symlink_to(files / "b")
    (files / "b").symlink_to(files / "a")
    for name in ("REPORT_FILE_ATTRIBUTES", "LIST_FILES", "DELETE_FILE"):
        assert flight.refused(name, {"path": "files/a"}) is Error.BAD_ARG
    flight.send("LIST_FILES", {"path": "files"})
    assert [told["path"] for told in flight.all("file_entry")] == ["files/a.txt"]
