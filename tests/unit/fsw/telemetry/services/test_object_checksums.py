"""Service 6: check-sums of tables and files."""

import zlib
from pathlib import Path

import pytest

from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.services import file_pieces
from fsw.telemetry.services.long_work import PIECES_PER_POLL
from tests.support.application_cases import BEGUN, Flight


@pytest.fixture
def folder(flight: Flight) -> Path:
    return flight.config.resolve(flight.config.service.state_directory) / "files"


def part(memory: str, base: str, offset: int = 0, length: int = 0) -> dict:
    return {"memory": memory, "base": base, "offset": offset, "length": length}


def test_a_file_is_checked_a_piece_at_a_time(
    flight: Flight, folder: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(file_pieces, "PIECE_BYTES", 100)
    data = bytes(k % 251 for k in range(250 * PIECES_PER_POLL))
    (folder / "a.bin").write_bytes(data)
    assert flight.send("CHECK_OBJECT", part("FILES", "files/a.bin")) == BEGUN
    assert flight.refused("CHECK_OBJECT", part("FILES", "files/a.bin")) is Error.BUSY
    flight.wait(0.1)
    assert flight.all("object_checked") == []
    flight.wait(0.2)
    told = flight.last("object_checked")
    assert (told["length"], told["crc32"]) == (len(data), zlib.crc32(data))
    assert flight.packets[-1].packet.name == "completion_success"
    flight.send("CHECK_OBJECT", part("FILES", "files/a.bin", 10, 20))
    flight.wait(0.1)
    assert flight.last("object_checked")["crc32"] == zlib.crc32(data[10:30])


def test_an_empty_file_and_one_that_shrinks(flight: Flight, folder: Path, monkeypatch):
    (folder / "empty").touch()
    flight.send("CHECK_OBJECT", part("FILES", "files/empty"))
    assert (flight.last("object_checked")["length"], flight.last("object_checked")["crc32"]) == (
        0,
        0,
    )
    monkeypatch.setattr(file_pieces, "PIECE_BYTES", 10)
    (folder / "b").write_bytes(bytes(200_000))
    flight.send("CHECK_OBJECT", part("FILES", "files/b"))
    (folder / "b").write_bytes(bytes(5))
    flight.wait(4.0)
    assert flight.error() is Error.FAILED


def test_a_table_is_checked_as_it_is_dumped(flight: Flight):
    flight.send("CHECK_OBJECT", part("TABLES", "NOISE/ACTIVE"))
    told = flight.last("object_checked")
    flight.send("TBL_DUMP", {"table": "NOISE", "copy": "ACTIVE"})
    assert told["crc32"] == flight.last("table_dumped")["crc32"]
    assert told["length"] == flight.last("table_dumped")["size_bytes"]


def test_what_is_not_there_is_refused(flight: Flight, folder: Path):
    (folder / "a").write_bytes(bytes(10))
    for values, error in (
        (part("FILES", "files/none"), Error.FILE_NOT_FOUND),
        (part("FILES", "files/../secret"), Error.BAD_ARG),
        (part("FILES", "files"), Error.FILE_NOT_FOUND),
        (part("FILES", "files/a", 11), Error.OUT_OF_RANGE),
        (part("FILES", "files/a", 5, 6), Error.OUT_OF_RANGE),
        (part("TABLES", "NOISE"), Error.BAD_ARG),
        (part("TABLES", "NOISE/OTHER"), Error.BAD_ARG),
        (part("TABLES", "NOISE/STAGED"), Error.NOT_STAGED),
        (part("TABLES", "NOISE/ACTIVE", 1 << 31), Error.OUT_OF_RANGE),
    ):
        assert flight.refused("CHECK_OBJECT", values) is error, values
