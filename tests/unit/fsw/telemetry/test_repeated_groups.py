"""Services 3, 5, 11 and 12 have the standard's N: layouts of ECSS-E-ST-70-41C, byte by byte."""

import struct

import pytest
from spacepackets.ecss.tc import PusTc

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error
from tests.support.application_cases import Flight

REPEATED = {
    (3, 5): "H",
    (3, 6): "H",
    (3, 27): "H",
    (3, 31): "HI",
    (3, 33): "H",
    (5, 5): "H",
    (5, 6): "H",
    (11, 5): "HHH",
    (12, 1): "H",
    (12, 2): "H",
    (12, 8): "H",
}
DONE = "completion_success"
STARTED, STOPPED = 1, 2  # events


def packet(service: int, subtype: int, data: bytes, sequence: int = 900) -> bytes:
    """Return a telecommand as any ground system builds it."""
    tc = PusTc(
        service=service,
        message_subtype=subtype,
        apid=100,
        app_data=data,
        seq_count=sequence,
        ack_flags=0b1111,
    )
    return bytes(tc.pack())


def give(flight: Flight, service: int, subtype: int, data: bytes) -> list[str]:
    """Give a telecommand; return the packets that came of it."""
    before = len(flight.packets)
    flight.app.executor.receive(packet(service, subtype, data))
    return [p.packet.name for p in flight.packets[before:]]


@pytest.mark.parametrize(("kind", "element"), REPEATED.items(), ids=str)
def test_the_dictionary_has_n_then_the_standards_elements(kind, element):
    found = next(t for t in DICTIONARY.telecommands if (t.service, t.subtype) == kind)
    first, *rest = found.arguments
    assert (first.name, first.size_bytes, found.repeats) == ("n", 1, True)
    assert [item.size_bytes for item in rest] == [struct.calcsize(part) for part in element]


def test_three_sets_are_disabled_by_one_telecommand(flight: Flight):
    assert DONE in give(flight, 3, 6, struct.pack(">BHHH", 3, 1, 2, 4))
    assert DONE in give(flight, 3, 33, struct.pack(">BHHH", 3, 1, 2, 4))
    told = flight.all("set_properties")
    assert [(item["n"], item["sid"], item["periodic"]) for item in told] == [
        (1, 1, 0),
        (1, 2, 0),
        (1, 4, 0),
    ]


def test_all_or_none_and_the_place_of_the_wrong_one(flight: Flight):
    data = struct.pack(">BHIHI", 2, 1, 500, 2, 9)  # 9 ms is too short
    assert "acceptance_failure" in give(flight, 3, 31, data)
    failure = flight.last("acceptance_failure")
    assert (Error(failure["error"]), failure["error_argument"]) == (Error.OUT_OF_RANGE, 5)
    give(flight, 3, 33, struct.pack(">BH", 1, 1))
    assert flight.last("set_properties")["interval_ms"] != 500
    none = struct.pack(">BHH", 2, STARTED, 0)  # rejected by its handler
    assert "acceptance_failure" in give(flight, 5, 6, none)
    assert flight.last("acceptance_failure")["error_argument"] == 3
    give(flight, 5, 7, b"")
    assert flight.last("disabled_events")["n"] == 0


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (b"", Error.BAD_LENGTH),
        (struct.pack(">BH", 0, 1), Error.OUT_OF_RANGE),
        (struct.pack(">B33H", 33, *range(33)), Error.OUT_OF_RANGE),
        (struct.pack(">BH", 2, 1), Error.BAD_LENGTH),
        (struct.pack(">BHH", 1, 1, 2), Error.BAD_LENGTH),
        (struct.pack(">BHH", 2, 1, 1), Error.BAD_ARG),
    ],
)
def test_a_group_of_another_size_or_with_a_double_is_rejected(flight: Flight, data, error):
    assert "acceptance_failure" in give(flight, 3, 5, data)
    assert flight.error() is error


def test_events_are_switched_and_reported_together(flight: Flight):
    assert DONE in give(flight, 5, 6, struct.pack(">BHH", 2, STARTED, STOPPED))
    assert DONE in give(flight, 5, 7, b"")
    told = flight.last("disabled_events")
    assert [told[name] for name in ("n", "event_1", "event_2", "event_3")] == [2, 1, 2, 0]


def test_two_activities_in_one_telecommand_and_both_deleted_by_another(flight: Flight):
    coarse = flight.now // 10**9 + 100
    pings = [packet(17, 1, b"", sequence=count) for count in (11, 12)]
    times = [struct.pack(">BI3x", 0x2F, coarse + k) for k in range(2)]
    inserted = b"\2" + times[1] + pings[0] + times[0] + pings[1]
    assert DONE in give(flight, 11, 4, inserted)
    assert DONE in give(flight, 11, 17, b"")
    told = flight.all("schedule_entry")
    names = ("n", "release_time_s", "source_id", "apid", "sequence_count")
    assert [tuple(item[name] for name in names) for item in told] == [
        (1, coarse, 0, 100, 12),
        (1, coarse + 1, 0, 100, 11),
    ]
    wrong = struct.pack(">BHHHHHH", 2, 0, 100, 11, 0, 100, 13)
    assert "acceptance_failure" in give(flight, 11, 5, wrong)
    assert flight.last("acceptance_failure")["error_argument"] == 7
    assert DONE in give(flight, 11, 5, struct.pack(">BHHHHHH", 2, 0, 100, 11, 0, 100, 12))
    give(flight, 11, 17, b"")
    assert flight.last("schedule_entry")["n"] == 0


def test_one_request_id_twice_in_one_telecommand_is_rejected(flight: Flight):
    coarse = flight.now // 10**9 + 100
    ping = packet(17, 1, b"", sequence=11)
    times = [struct.pack(">BI3x", 0x2F, coarse + k) for k in range(2)]
    twice = b"\2" + times[0] + ping + times[1] + ping
    assert "acceptance_failure" in give(flight, 11, 4, twice)
    assert flight.error() is Error.BAD_ARG
    give(flight, 11, 17, b"")
    assert flight.last("schedule_entry")["n"] == 0


def test_an_activity_that_ends_before_its_packet_does_is_rejected(flight: Flight):
    coarse = flight.now // 10**9 + 100
    ping = packet(17, 1, b"", sequence=11)
    cut = b"\1" + struct.pack(">BI3x", 0x2F, coarse) + ping
    for size in range(1, len(cut)):
        assert "acceptance_failure" in give(flight, 11, 4, cut[:size])
        assert flight.error() is Error.BAD_LENGTH
