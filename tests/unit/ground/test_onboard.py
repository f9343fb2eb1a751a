"""Playback, sequences and kept telecommands from the ground, against the daemon's own services."""

import pytest

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.link.packets import Packetizer
from fsw.telemetry.services.sequences import parse_entries
from ground.__main__ import main
from ground.commands import Catalogue
from ground.errors import UsageError
from ground.playback import (
    LAST_S,
    MOST_RANGES,
    Range,
    merged,
    missing_ranges,
    new_packets,
    read_stream,
)
from ground.sequence import compile_sequence
from tests.support.application_cases import SECOND, Flight
from tests.support.open_flight import OpenFlight

EVENT = {"event": 1, "occurrence": 1, "suppressed": 0}


def events(count: int, start_s: int = 100) -> list[bytes]:
    packetizer = Packetizer()
    return [
        packetizer.make("event_info", (start_s + k) * SECOND, EVENT | {"text": f"{k}"})
        for k in range(count)
    ]


class TestRanges:
    def test_a_whole_stream_lacks_only_what_comes_after_it(self):
        found = missing_ranges(events(20))
        assert found["EVENTS"] == found["HOUSEKEEPING"] == [Range(119.0, LAST_S)]
        assert found["SCIENCE"] == [Range(0.0, LAST_S)]

    def test_gaps_are_found_by_count_and_asked_for_by_time(self):
        stream = events(20)
        lacking = stream[:5] + stream[8:12] + stream[13:]
        assert missing_ranges(lacking)["EVENTS"] == [
            Range(104.0, 108.0),
            Range(111.0, 113.0),
            Range(119.0, LAST_S),
        ]

    def test_counts_wrap_and_what_was_added_later_fills_a_gap(self):
        packetizer = Packetizer()
        packetizer._sequences[100] = (1 << 14) - 3
        stream = [
            packetizer.make("event_info", k * SECOND, EVENT | {"text": ""}) for k in range(1, 9)
        ]
        assert missing_ranges(stream)["EVENTS"] == [Range(8.0, LAST_S)]
        assert missing_ranges(stream[:2] + stream[5:] + stream[2:5])["EVENTS"] == [
            Range(8.0, LAST_S)
        ]

    def test_ranges_that_touch_are_one_and_too_many_are_one(self):
        assert merged([Range(5, 6), Range(1, 2), Range(2, 4)]) == [Range(1, 4), Range(5, 6)]
        many = [Range(2 * k, 2 * k + 1) for k in range(MOST_RANGES + 1)]
        assert merged(many) == [Range(0, 2 * MOST_RANGES + 1)]

    def test_only_new_packets_are_added_each_once(self):
        stream = events(6)
        assert new_packets(stream[:3], [*stream, stream[5]]) == stream[3:]


class TestPlayback:
    def test_what_a_kept_stream_lacks_is_added_to_it(self, flight: Flight, tmp_path, capsys):
        for _ in range(12):
            flight.send("REPORT_SET", {"sid": 8})
            flight.send("REPORT_SET", {"sid": 1})
            flight.wait(1.0)
        whole = [raw for raw in flight.raw if raw[7:9] == b"\x03\x19"]
        path = tmp_path / "stream.bin"
        lost = set(whole[6:11]) | set(whole[20:])
        path.write_bytes(b"".join(raw for raw in flight.raw if raw not in lost))
        with OpenFlight(flight) as served:
            code = main(["--port", str(served.port), "playback", "--missed", str(path)])
        assert code == 0
        found = read_stream(path)
        assert set(whole) <= set(found)
        assert len(found) == len(set(found))
        assert "completed" in capsys.readouterr().out

    @pytest.mark.parametrize(("start_s", "count"), [("1001", 3), ("0", 4)])
    def test_a_time_range_of_one_store_into_a_file(
        self, flight: Flight, tmp_path, start_s: str, count: int
    ):
        for _ in range(5):
            flight.send("REPORT_SET", {"sid": 8})
            flight.wait(1.0)
        path = tmp_path / "out.bin"
        words = ["playback", "housekeeping", "--from", start_s, "--to", "1003", "--out", str(path)]
        with OpenFlight(flight) as served:
            for _ in range(2):
                flight.send("REPORT_SET", {"sid": 8})  # later than the range
                assert main(["--port", str(served.port), *words]) == 0
        assert len(read_stream(path)) == count

    @pytest.mark.parametrize(
        "words",
        [
            ["playback"],
            ["playback", "nowhere", "--out", "x"],
            ["playback", "--out", "x", "--from", "5", "--to", "4"],
            ["playback", "--missed", "no such file"],
        ],
    )
    def test_a_wrong_command_line_opens_no_link(self, words, capsys):
        assert main(["--port", "1", *words]) == 2
        assert capsys.readouterr().err.startswith("ground: ")


class TestSequences:
    def test_text_becomes_entries_that_the_daemon_accepts(self):
        text = "# to safety\nPING\nwait 1.5\nwait 0.5\nSET_MODE mode=STANDBY  # rest\n\n"
        counts = iter(range(100))
        data = compile_sequence(text, Catalogue(), lambda: next(counts))
        found = parse_entries(data)
        assert [entry.delay_ms for entry in found] == [2000, 0]
        assert [entry.packet[7:9] for entry in found] == [b"\x11\x01", b"\x08\x01"]

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("", "no telecommand"),
            ("wait 1\nPING", "line 1"),
            ("PING\nwait nan", "line 2"),
            ("PING\nwait -1", "line 2"),
            ("PING\nNOTHING", "line 2: NOTHING"),
            ("PING x=1", "line 1: PING"),
            ("PING 'x", "line 1"),
        ],
    )
    def test_a_wrong_line_is_named(self, text, words):
        with pytest.raises(UsageError, match=words):
            compile_sequence(text, Catalogue(), lambda: 0)

    def test_it_is_loaded_and_started(self, flight: Flight, tmp_path, capsys):
        path = tmp_path / "steps.txt"
        path.write_text("PING\nwait 0.1\nPING\n")
        with OpenFlight(flight) as served:
            code = main(["--port", str(served.port), "sequence", "3", str(path), "--start"])
        assert code == 0
        assert "START_SEQUENCE: completed" in capsys.readouterr().out
        assert "SEQUENCE_STARTED" in flight.codes

    def test_a_long_one_goes_up_as_a_file(self, flight: Flight, tmp_path):
        path = tmp_path / "steps.txt"
        path.write_text("PING\nwait 60\n" * 60)
        state = ["--state", str(tmp_path / "ground")]
        with OpenFlight(flight) as served:
            assert main(["--port", str(served.port), *state, "sequence", "1", str(path)]) == 0
        assert len(flight.app.onboard.sequences._entries[1]) == 60

    def test_a_place_there_is_not_is_refused_by_name_and_bound(self, flight, tmp_path, capsys):
        path = tmp_path / "steps.txt"
        path.write_text("PING\n")
        with OpenFlight(flight) as served:
            assert main(["--port", str(served.port), "sequence", "17", str(path)]) == 2
        assert "sequence: 17" in capsys.readouterr().err


def test_a_telecommand_is_kept_for_an_event(flight: Flight, capsys):
    with OpenFlight(flight) as served:
        port = ["--port", str(served.port)]
        assert main([*port, "tc", "SET_MODE", "mode=SAFE", "--on", "PORT_LOST"]) == 0
        named = ["apid=100", "event=PORT_LOST"]
        assert main([*port, "tc", "ENABLE_EVENT_ACTION", *named]) == 0
        capsys.readouterr()
        assert main([*port, "tc", "REPORT_EVENT_ACTION", *named]) == 0
    out = capsys.readouterr().out
    kept = Catalogue().build("SET_MODE", {"mode": "SAFE"}, 0)
    assert kept[6:-2].hex() in out
    assert "enabled=ENABLED" in out


def test_an_event_there_is_not_opens_no_link(capsys):
    assert main(["--port", "1", "tc", "PING", "--on", "NO_SUCH"]) == 2
    assert "event" in capsys.readouterr().err


def test_every_new_telecommand_is_built_by_the_xtce_as_by_the_dictionary():
    names = {t.name for t in DICTIONARY.telecommands if t.service in (6, 15, 19, 21)}
    assert names <= set(Catalogue().commands)
