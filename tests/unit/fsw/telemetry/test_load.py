"""What the other side of the link can ask for, at most: work of one poll, answers, events."""

import socket

from fsw.messages import Event
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import Decoder, telecommand_packet
from fsw.telemetry.services.eventing import LOG_ENTRIES
from fsw.telemetry.services.ground_link import MAX_ITEMS
from fsw.telemetry.services.long_work import PIECES_PER_POLL
from tests.support.application_cases import DONE, SECOND, Flight, flight_config

REPORTS = 5  # of one telecommand: verification and events
DUMP = DICTIONARY.telecommand("EVENT_LOG_DUMP")


def leap(flight: Flight, seconds: float) -> None:
    """Let time go by in whole seconds."""
    for _ in range(round(seconds)):
        flight.now += SECOND
        flight.app.poll(flight.now)


def fill_log(flight: Flight, count: int = LOG_ENTRIES) -> None:
    for k in range(count):
        flight.app.event(Event(flight.now, "info", "BATCH_DONE", str(k)))


def test_a_flood_of_dumps_is_spread_over_polls_and_health_goes_on(arm):
    """6.8 kB of EVENT_LOG_DUMP held the service up for 17 s."""
    flight = Flight(flight_config(arm, housekeeping_interval_s=0.1))
    flight.up()
    fill_log(flight)
    flight.app.open()
    made: list[int] = []
    names: list[str] = []
    decoder, send = Decoder(), flight.app.link.server.send

    def count(packet: bytes, priority: int) -> None:
        made[-1] += 1
        names.append(decoder.decode(packet).packet.name)
        send(packet, priority)

    flight.app.context.down.out = count
    requests = [telecommand_packet(DUMP, {"entries": 1000}, k) for k in range(400)]
    with socket.create_connection(("127.0.0.1", flight.app.link.server.port)) as client:
        client.sendall(b"".join(requests))
        while names.count("event_log_entry") < LOG_ENTRIES or names.count("acceptance_failure") < 9:
            made.append(0)
            flight.now += SECOND // 100
            flight.app.poll(flight.now)
    assert max(made) <= REPORTS * MAX_ITEMS + PIECES_PER_POLL + len(DICTIONARY.packets)
    polls = len(made)
    assert polls >= LOG_ENTRIES / PIECES_PER_POLL
    assert names.count("health") >= polls // 10 - 1, "every 0.1 s, whatever else goes down"
    flight.app.close()


def test_one_dump_of_a_kind_at_a_time(flight):
    fill_log(flight)
    assert flight.send("EVENT_LOG_DUMP", {"entries": 1000})[:2] == DONE[:2]
    assert len(flight.all("event_log_entry")) == PIECES_PER_POLL
    assert flight.refused("EVENT_LOG_DUMP", {"entries": 10}) is Error.BUSY
    leap(flight, LOG_ENTRIES / PIECES_PER_POLL + 1.0)
    entries = flight.all("event_log_entry")
    assert [e["entry"] for e in entries] == list(range(1, LOG_ENTRIES + 1))
    assert flight.send("EVENT_LOG_DUMP", {"entries": 2})[:2] == DONE[:2]
    assert "completion_success" in [p.packet.name for p in flight.packets[-5:]]


def refused_for_two_minutes(flight: Flight) -> int:
    """Send refused packets for two minutes, a hundred a second."""
    bad = bytearray(telecommand_packet(DICTIONARY.telecommand("PING"), {}, 1))
    bad[-1] ^= 1
    count = 0
    for _ in range(120):
        for _ in range(100):
            flight.app.executor.receive(bytes(bad))
            count += 1
        leap(flight, 1.0)
    return count


def test_two_minutes_of_refused_packets_leave_the_history_as_it_was(flight):
    fill_log(flight, 300)
    before = len(flight.events)
    count = refused_for_two_minutes(flight)
    assert count == 12_000
    assert flight.app.executor.counters.tc_rejected == count, "counted all the same"
    leap(flight, 700.0)
    told = [event for event in flight.events[before:] if event.code == "TC_REJECTED"]
    assert 5 < len(told) < 15, "log and recording get the first ones, then the rate"
    summed = sum(int(e.text.split()[0]) for e in told if " more within " in e.text)
    assert summed + sum(" more within " not in event.text for event in told) == count
    flight.send("EVENT_LOG_DUMP", {"entries": 1000})
    leap(flight, 40.0)
    texts = [entry["text"] for entry in flight.all("event_log_entry")]
    assert {str(k) for k in range(300)} <= set(texts)


def test_after_a_quiet_time_refusals_are_reported_one_by_one_again(flight):
    refused_for_two_minutes(flight)
    leap(flight, 1300.0)
    before = len(flight.events)
    assert flight.app.executor.receive(b"\x18\x64" + bytes(20)) is False
    assert [event.code for event in flight.events[before:]] == ["TC_REJECTED"]
    assert "more within" not in flight.events[-1].text


def test_a_summary_is_not_lost_at_the_end(flight):
    for _ in range(20):
        flight.app.executor.receive(b"\x18\x64" + bytes(20))
    flight.app.close()
    assert "15 more within" in flight.events[-1].text


def test_however_much_one_event_repeats_the_others_stay(flight):
    fill_log(flight, 40)
    for k in range(5000):
        flight.app.event(Event(flight.now, "low", "LIMIT_VIOLATED", f"limit {k}"))
    flight.send("EVENT_LOG_DUMP", {"entries": 1000})
    leap(flight, 40.0)
    texts = [entry["text"] for entry in flight.all("event_log_entry")]
    assert len(texts) == LOG_ENTRIES
    assert {str(k) for k in range(40)} <= set(texts)
    assert texts[-1] == "limit 4999"
    assert texts == sorted(texts, key=texts.index), "in order of time"
