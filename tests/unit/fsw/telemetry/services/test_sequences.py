"""Service 21: sequences of telecommands."""

import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import telecommand_packet
from fsw.telemetry.link.telecommands import TcError
from fsw.telemetry.services.sequences import MAX_BYTES, MAX_DELAY_MS, MAX_ENTRIES, parse_entries
from tests.support.application_cases import DONE, Flight


def packet(name: str, count: int = 1, **values: object) -> bytes:
    return telecommand_packet(DICTIONARY.telecommand(name), values, count)


def entries(*parts: tuple[bytes, int]) -> bytes:
    return b"".join(request + struct.pack(">I", delay_ms) for request, delay_ms in parts)


def pings(*delays_ms: int) -> bytes:
    return entries(*((packet("PING", k), delay_ms) for k, delay_ms in enumerate(delays_ms)))


def load(flight: Flight, data: bytes, number: int = 1) -> None:
    assert flight.send("LOAD_SEQUENCE", {"sequence": number, "entries": data})[-1] == DONE[-1]


def test_telecommands_are_released_with_their_delays(flight: Flight):
    load(flight, pings(1000, 500, 0))
    assert flight.send("START_SEQUENCE", {"sequence": 1})[-1] == DONE[-1]
    seen = []
    for _ in range(20):
        flight.wait(0.1)
        seen.append(len(flight.all("alive")))
    assert seen[7:10] == [1, 1, 2]
    assert seen[13:15] == [2, 3]
    assert flight.codes.count("SEQUENCE_ENDED") == 1
    flight.send("REPORT_SEQUENCES")
    told = flight.last("sequence_status")
    assert (told["n"], told["status"], told["released"], told["entries"]) == (1, 0, 3, 3)


def test_loaded_ones_survive_a_restart_and_running_ones_are_aborted_and_reported(flight: Flight):
    data = pings(1000, 0)
    load(flight, data, 3)
    flight.send("START_SEQUENCE", {"sequence": 3})
    flight.wait(0.1)
    again = Flight(flight.config)
    assert again.codes.count("SEQUENCE_ABORTED") == 1
    again.wait(3.0)
    assert again.all("alive") == []
    again.send("CHECK_SEQUENCE", {"sequence": 3})
    assert again.last("sequence_checked")["crc32"] == zlib.crc32(data)
    assert Flight(flight.config).codes.count("SEQUENCE_ABORTED") == 0


def test_content_is_reported_and_unloaded_for_good(flight: Flight):
    load(flight, pings(7, 8))
    flight.send("REPORT_SEQUENCE", {"sequence": 1})
    told = flight.all("sequence_entry")
    assert [(t["entry"], t["n"], t["delay_ms"]) for t in told] == [(1, 2, 7), (2, 2, 8)]
    assert bytes.fromhex(told[0]["request_hex"]) == packet("PING", 0)
    assert flight.send("UNLOAD_SEQUENCE", {"sequence": 1})[-1] == DONE[-1]
    assert flight.refused("UNLOAD_SEQUENCE", {"sequence": 1}) is Error.NOT_STAGED
    assert Flight(flight.config).app.onboard.sequences.digest() == [{}, {}]


def test_one_that_executes_is_left_alone_until_it_is_aborted(flight: Flight):
    load(flight, pings(60_000, 0))
    flight.send("START_SEQUENCE", {"sequence": 1})
    for name in ("START_SEQUENCE", "UNLOAD_SEQUENCE"):
        assert flight.refused(name, {"sequence": 1}) is Error.BUSY
    assert flight.refused("LOAD_SEQUENCE", {"sequence": 1, "entries": pings(0)}) is Error.BUSY
    assert flight.send("ABORT_SEQUENCE", {"sequence": 1})[-1] == DONE[-1]
    assert flight.refused("ABORT_SEQUENCE", {"sequence": 1}) is Error.NOT_STAGED
    flight.send("START_SEQUENCE", {"sequence": 1})
    flight.send("ABORT_SEQUENCES")
    assert flight.last("sequence_aborted") == {"n": 1, "sequence": 1}
    flight.send("ABORT_SEQUENCES")
    assert flight.last("sequence_aborted") == {"n": 0, "sequence": 0}


def test_it_is_loaded_from_a_file_that_came_up(flight: Flight):
    state = flight.config.resolve(flight.config.service.state_directory)
    (state / "files" / "steps.seq").write_bytes(pings(0, 0))
    named = {"sequence": 2, "path": "files/steps.seq"}
    assert flight.send("LOAD_SEQUENCE_FILE", named)[-1] == DONE[-1]
    flight.send("START_SEQUENCE", {"sequence": 2})
    flight.wait(0.3)
    assert len(flight.all("alive")) == 2
    missing = named | {"path": "files/none"}
    assert flight.refused("LOAD_SEQUENCE_FILE", missing) is Error.FILE_NOT_FOUND
    (state / "files" / "steps.seq").write_bytes(bytes(MAX_BYTES + 1))
    assert flight.refused("LOAD_SEQUENCE_FILE", named) is Error.BAD_LENGTH


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (packet("PING"), Error.BAD_LENGTH),
        (pings(0)[:-1], Error.BAD_LENGTH),
        (pings(0) + b"\x18", Error.BAD_LENGTH),
        (pings(MAX_DELAY_MS + 1), Error.OUT_OF_RANGE),
        (pings(*[0] * (MAX_ENTRIES + 1)), Error.OUT_OF_RANGE),
        (entries((packet("PING")[:-1] + b"\0", 0)), Error.BAD_CRC),
        (entries((packet("START_SEQUENCE", sequence=1), 0)), Error.BAD_ARG),
        (entries((packet("ABORT_SEQUENCES"), 0)), Error.BAD_ARG),
    ],
)
def test_what_is_no_sequence_is_refused_and_the_old_one_stays(flight: Flight, data, error):
    load(flight, pings(1))
    before = flight.app.onboard.sequences.digest()
    assert flight.refused("LOAD_SEQUENCE", {"sequence": 1, "entries": data}) is error
    assert flight.app.onboard.sequences.digest() == before


def test_numbers_outside_the_places_are_refused(flight: Flight):
    for number in (0, 17, 255):
        assert flight.refused("START_SEQUENCE", {"sequence": number}) is Error.OUT_OF_RANGE
    assert flight.refused("START_SEQUENCE", {"sequence": 16}) is Error.NOT_STAGED


@given(st.binary(max_size=200))
def test_arbitrary_bytes_give_entries_or_a_reason(data: bytes):
    try:
        found = parse_entries(data)
    except TcError:
        return
    assert entries(*((item.packet, item.delay_ms) for item in found)) == data
