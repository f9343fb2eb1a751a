"""Lists and work on files: at most so many pieces in one poll, whatever is asked for."""

import os
import zlib
from pathlib import Path

import pytest

from file_delivery.transfer import Transfer, TransferState
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.services import file_pieces
from fsw.telemetry.services.long_work import PIECES_PER_POLL
from tests.support.application_cases import BEGUN, DONE, SECOND, Flight
from tests.unit.fsw.telemetry.services.test_filing import FakeDelivery
from tests.unit.fsw.telemetry.services.test_schedule import ping
from tests.unit.fsw.telemetry.services.test_sequences import pings
from tests.unit.fsw.telemetry.services.test_single_monitors import definition
from tests.unit.fsw.telemetry.test_reactions import at

ROWS = 64
SIZE_BYTES = 3 * PIECES_PER_POLL * file_pieces.PIECE_BYTES // 2


def poll(flight: Flight) -> None:
    flight.now += SECOND // 100
    flight.app.poll(flight.now)


def filled(flight: Flight) -> Flight:
    """Fill every list."""
    for k in range(ROWS):
        flight.send("ADD_MONITOR", definition(k + 1))
        flight.send("INSERT_ACTIVITY", at(1000.0 + k, flight, ping(k)))
    flight.send("LOAD_SEQUENCE", {"sequence": 1, "entries": pings(*(ROWS * [0]))})
    delivery = FakeDelivery()
    delivery.under_way = [
        Transfer((2, k), "up.bin", 9, 4, TransferState.RECEIVING, 0) for k in range(ROWS)
    ]
    flight.app.transfers.delivery = delivery
    poll(flight)
    return flight


LISTS = {
    "REPORT_MONITOR_STATUS": ("monitor_status", {}),
    "REPORT_SCHEDULE": ("schedule_entry", {}),
    "REPORT_SCHEDULE_DETAIL": ("schedule_detail", {}),
    "REPORT_SEQUENCE": ("sequence_entry", {"sequence": 1}),
    "REPORT_TRANSFERS": ("transfer_status", {}),
}


def test_lists_share_the_pieces_of_a_poll_and_none_waits_for_another(flight: Flight):
    filled(flight)
    for name, (_, values) in LISTS.items():
        assert flight.send(name, values)[:2] == BEGUN
    rows = [len(flight.all(packet)) for packet, _ in LISTS.values()]
    assert rows == [PIECES_PER_POLL, 0, 0, 0, 0]
    poll(flight)
    more = [len(flight.all(packet)) for packet, _ in LISTS.values()]
    assert sum(more) - sum(rows) == PIECES_PER_POLL
    assert min(more) >= PIECES_PER_POLL // len(LISTS), "each in turn"
    for _ in range(len(LISTS) * ROWS // PIECES_PER_POLL):
        poll(flight)
    assert [len(flight.all(packet)) for packet, _ in LISTS.values()] == len(LISTS) * [ROWS]
    assert flight.send("REPORT_SCHEDULE")[:2] == BEGUN, "over, and can be requested again"


def test_a_large_file_is_checked_while_the_rest_goes_on(flight: Flight, folder: Path):
    data = os.urandom(SIZE_BYTES)
    (folder / "large").write_bytes(data)
    assert flight.send("REPORT_FILE_ATTRIBUTES", {"path": "files/large"}) == BEGUN
    assert flight.send("PING")[-1] == DONE[-1]
    assert flight.all("file_attributes") == []
    poll(flight)
    found = flight.last("file_attributes")
    assert (found["size_bytes"], found["crc32"]) == (SIZE_BYTES, zlib.crc32(data))


def test_a_large_copy_appears_when_it_is_whole_and_keeps_others_off(flight: Flight, folder: Path):
    data = os.urandom(SIZE_BYTES)
    (folder / "large").write_bytes(data)
    given = {"path": "files/large", "target": "files/sub/copy"}
    assert flight.send("COPY_FILE", given) == BEGUN
    assert not (folder / "sub/copy").exists()
    assert flight.refused("DELETE_FILE", {"path": "files/large"}) is Error.BUSY
    assert flight.refused("MOVE_FILE", {"path": "files/large", "target": "files/x"}) is Error.BUSY
    away = {"path": "files/sub", "target": "files/away"}
    assert flight.refused("RENAME_DIRECTORY", away) is Error.BUSY
    poll(flight)
    assert (folder / "sub/copy").read_bytes() == data
    assert flight.send("DELETE_FILE", {"path": "files/large"}) == DONE
    assert sorted(path.name for path in (folder / "sub").iterdir()) == ["copy"]


def test_what_fails_halfway_leaves_the_files_as_they_were(
    flight: Flight, folder: Path, monkeypatch: pytest.MonkeyPatch
):
    def full(reader, writer, _length):
        writer.write(reader.read(10))
        yield
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(file_pieces, "_pour", full)
    (folder / "piece").write_bytes(bytes(100))
    (folder / "whole").write_bytes(b"hello")
    given = {"path": "files/piece", "target": "files/whole"}
    assert "completion_failure" in flight.send("APPEND_FILE", given | {"offset": 5})
    assert (folder / "whole").read_bytes() == b"hello"
    assert "completion_failure" in flight.send("COPY_FILE", given | {"target": "files/new"})
    assert flight.error() is Error.FAILED
    assert sorted(path.name for path in folder.iterdir()) == ["piece", "whole"]


def test_a_file_is_not_appended_to_itself(flight: Flight, folder: Path):
    """It would grow as it is read, until the disk is full."""
    (folder / "a").write_bytes(b"hello")
    (folder / "b").symlink_to(folder / "a")
    for path, target in (("a", "a"), ("b", "a"), ("a", "b")):
        given = {"path": f"files/{path}", "target": f"files/{target}", "offset": 5}
        assert flight.refused("APPEND_FILE", given) is Error.BAD_ARG
    assert (folder / "a").read_bytes() == b"hello"


def test_a_file_that_grows_while_it_is_copied_is_copied_as_it_was(folder: Path):
    (folder / "log").write_bytes(bytes(SIZE_BYTES))
    for _ in file_pieces.copy(folder / "log", folder / "copy"):
        with (folder / "log").open("ab") as file:
            file.write(bytes(2 * file_pieces.PIECE_BYTES))
    assert (folder / "copy").stat().st_size == SIZE_BYTES


def test_the_end_of_the_service_leaves_no_half_file(flight: Flight, folder: Path):
    (folder / "large").write_bytes(bytes(SIZE_BYTES))
    (folder / "whole").write_bytes(b"hello")
    given = {"path": "files/large", "target": "files/whole", "offset": 5}
    assert flight.send("APPEND_FILE", given) == BEGUN
    assert (folder / "whole").stat().st_size > 5
    flight.app.close()
    assert (folder / "whole").read_bytes() == b"hello"
    assert (folder / "large").stat().st_size == SIZE_BYTES


def test_an_end_halfway_leaves_no_half_file(folder: Path):
    (folder / "large").write_bytes(bytes(SIZE_BYTES))
    (folder / "whole").write_bytes(b"hello")
    for pieces in (
        file_pieces.copy(folder / "large", folder / "new"),
        file_pieces.append(folder / "large", folder / "whole", 5),
    ):
        next(pieces)
        pieces.close()
    assert (folder / "whole").read_bytes() == b"hello"
    assert sorted(path.name for path in folder.iterdir()) == ["large", "whole"]


@pytest.fixture
def folder(flight: Flight) -> Path:
    return flight.config.resolve(flight.config.service.state_directory) / "files"
