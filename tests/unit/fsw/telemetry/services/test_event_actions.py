"""Service 19: actions of events, their bounds, and the end of every loop of them."""

import errno

import pytest

from fsw.messages import Event
from fsw.messages.commands import CommandName
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import telecommand_packet
from fsw.telemetry.services.event_actions import CAPACITY, MOST_A_DAY, MOST_RELEASES
from fsw.telemetry.state.epoch import Epoch
from fsw.telemetry.state.store import GenerationStore
from tests.support.application_cases import DONE, EPOCH, SECOND, Flight

APID = {"apid": 100}


def packet(name: str, count: int = 1, **values: object) -> bytes:
    return telecommand_packet(DICTIONARY.telecommand(name), values, count)


PING = packet("PING")


def add(flight: Flight, event: str, request: bytes = PING, *, enabled: bool = True) -> None:
    assert flight.send("ADD_EVENT_ACTION", {**APID, "event": event, "request": request}) == DONE
    if enabled:
        assert flight.send("ENABLE_EVENT_ACTION", {**APID, "event": event}) == DONE


def happens(flight: Flight, code: str) -> None:
    flight.app.event(Event(flight.now, "low", code, ""))


def status(flight: Flight) -> list[tuple[int, int]]:
    """Report the definitions: event and whether it is enabled."""
    flight.packets.clear()
    flight.send("REPORT_EVENT_ACTION_STATUS")
    return [(v["event"], v["enabled"]) for v in flight.all("event_action_status") if v["n"]]


def test_an_enabled_action_is_released_at_the_next_poll(flight: Flight):
    add(flight, "STOPPED", enabled=False)
    happens(flight, "STOPPED")
    flight.wait(0.1)
    assert flight.all("alive") == []
    flight.send("ENABLE_EVENT_ACTION", {**APID, "event": "STOPPED"})
    happens(flight, "STOPPED")
    assert flight.all("alive") == []
    flight.wait(0.1)
    assert len(flight.all("alive")) == 1
    assert "EVENT_ACTION" in flight.codes


def test_definitions_and_switches_survive_a_restart(flight: Flight):
    add(flight, "STOPPED")
    add(flight, "LINK_OPENED", enabled=False)
    again = Flight(flight.config)
    again.up()
    assert status(again) == [(2, 1), (64, 0)]
    happens(again, "STOPPED")
    again.wait(0.1)
    assert len(again.all("alive")) == 1
    again.send("DISABLE_EVENT_ACTIONS")
    third = Flight(flight.config)
    happens(third, "STOPPED")
    third.wait(0.2)
    assert third.all("alive") == []
    third.send("ENABLE_EVENT_ACTIONS")
    happens(third, "STOPPED")
    third.wait(0.2)
    assert len(third.all("alive")) == 1


def test_it_is_reported_and_deleted(flight: Flight):
    assert status(flight) == []
    add(flight, "STOPPED")
    named = {**APID, "event": "STOPPED"}
    flight.send("REPORT_EVENT_ACTION", named)
    assert bytes.fromhex(flight.last("event_action")["request_hex"]) == PING
    assert flight.refused("DELETE_EVENT_ACTION", named) is Error.BUSY
    assert flight.refused("ADD_EVENT_ACTION", named | {"request": PING}) is Error.BUSY
    flight.send("DISABLE_EVENT_ACTION", named)
    assert flight.send("DELETE_EVENT_ACTION", named) == DONE
    assert flight.refused("DELETE_EVENT_ACTION", named) is Error.BAD_ARG
    add(flight, "STOPPED")
    assert flight.send("DELETE_EVENT_ACTIONS") == DONE
    assert status(flight) == []


def test_what_cannot_be_kept_is_refused_with_its_reason(flight: Flight):
    def refused(event: object, request: bytes, apid: int = 100) -> Error:
        return flight.refused(
            "ADD_EVENT_ACTION", {"apid": apid, "event": event, "request": request}
        )

    assert refused("NONE", PING) is Error.BAD_ARG
    assert refused("STOPPED", PING, apid=101) is Error.OUT_OF_RANGE
    assert refused("STOPPED", PING[:-1]) is Error.BAD_LENGTH
    assert refused("STOPPED", PING[:-1] + b"\0") is Error.BAD_CRC
    assert refused("STOPPED", packet("DELETE_EVENT_ACTIONS")) is Error.BAD_ARG
    long = packet("TBL_DATA", table="NOISE", offset=0, data=bytes(250))
    assert refused("STOPPED", long) is Error.BAD_LENGTH
    codes = [event.code for event in DICTIONARY.events][: CAPACITY + 1]
    for code in codes[:-1]:
        add(flight, code, enabled=False)
    assert refused(codes[-1], PING) is Error.BUSY


@pytest.mark.parametrize("cause", ["EVENT_ACTION", "TC_COMPLETED"])
def test_an_action_that_causes_its_own_event_is_disabled_after_a_few_times(
    flight: Flight, cause: str
):
    add(flight, cause)
    happens(flight, cause)
    flight.wait(5.0)
    assert flight.codes.count("EVENT_ACTION") == MOST_RELEASES
    assert flight.codes.count("EVENT_ACTION_LIMITED") == 1
    ((_, enabled),) = status(flight)
    assert not enabled
    assert not Flight(flight.config).app.onboard.actions._definitions.popitem()[1].enabled


@pytest.mark.parametrize("cause", ["TC_REJECTED", "EVENT_ACTION_LIMITED"])
def test_an_action_that_is_refused_each_time_ends_too(flight: Flight, cause: str):
    add(flight, cause, packet("START_SEQUENCE", sequence=1))  # none is loaded: rejected
    happens(flight, cause)
    flight.wait(5.0)
    assert flight.codes.count("EVENT_ACTION") <= MOST_RELEASES


def test_two_that_cause_each_other_end_too(flight: Flight):
    add(flight, "TC_REJECTED", packet("STOP_IDENTIFICATION", 1))
    add(flight, "TC_FAILED", packet("START_SEQUENCE", 2, sequence=1))
    add(flight, "EVENT_ACTION", packet("START_SEQUENCE", 3, sequence=2))
    happens(flight, "TC_FAILED")
    flight.wait(30.0)
    assert flight.codes.count("EVENT_ACTION") <= 3 * MOST_RELEASES


def test_a_flood_of_events_queues_no_more_than_its_bound(flight: Flight):
    codes = [event.code for event in DICTIONARY.events if event.id >= 200][:CAPACITY]
    for count, code in enumerate(codes):
        add(flight, code, packet("PING", count))
    for _ in range(5):
        for code in codes:
            happens(flight, code)
    assert "EVENT_ACTION_LOST" in flight.codes
    flight.wait(2.0)
    assert len(flight.all("alive")) == CAPACITY


def test_slow_repetition_is_no_loop(flight: Flight):
    add(flight, "STOPPED")
    for _ in range(2 * MOST_RELEASES):
        happens(flight, "STOPPED")
        flight.up()
        flight.wait(7.0)
    assert len(flight.all("alive")) == 2 * MOST_RELEASES


def restarted(flight: Flight, *, after_s: float = 5.0, epoch: Epoch = EPOCH) -> Flight:
    """Start the daemon again some seconds after the start of the machine."""
    flight.app.close()
    return Flight(flight.config, now=round(after_s * SECOND), epoch=epoch)


@pytest.mark.parametrize("boot_utc_s", [0, 20])
def test_an_action_that_restarts_the_daemon_ends(flight: Flight, boot_utc_s: int):
    # each start of the machine: another clock, whose time of day moves on, or starts where it was
    add(flight, "MODE_CHANGED", packet("RESTART", key=0xB007))
    restarts = 0
    for start in range(3 * MOST_RELEASES):
        flight.up(identifying=False)
        happens(flight, "MODE_CHANGED")
        flight.wait(0.5)
        if not any(command.name == CommandName.RESTART for command in flight.commands):
            break
        restarts += 1
        epoch = Epoch(clock_id=f"boot {start}", utc_less_met_ns=boot_utc_s * start * SECOND)
        flight = restarted(flight, epoch=epoch)
    assert 0 < restarts <= MOST_RELEASES
    assert "EVENT_ACTION_LIMITED" in flight.codes
    flight.app.close()


def test_a_restart_that_cannot_be_counted_is_not_released(flight: Flight, monkeypatch):
    add(flight, "MODE_CHANGED", packet("RESTART", key=0xB007))
    add(flight, "STOPPED")
    flight.up(identifying=False)

    def full(_store: GenerationStore, _content: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(GenerationStore, "write", full)
    happens(flight, "MODE_CHANGED")
    happens(flight, "STOPPED")
    flight.wait(1.0)
    assert not any(command.name == CommandName.RESTART for command in flight.commands)
    assert "EVENT_ACTION_LOST" in flight.codes
    assert flight.all("alive"), "any other action acts"


def test_an_action_that_repeats_all_day_is_disabled(flight: Flight):
    add(flight, "STOPPED")
    for _ in range(MOST_A_DAY + 5):
        happens(flight, "STOPPED")
        flight.up()
        flight.wait(1.0)
        flight.now += 60 * SECOND
    assert flight.codes.count("EVENT_ACTION") == MOST_A_DAY
    assert "EVENT_ACTION_LIMITED" in flight.codes


@pytest.mark.parametrize("event", ["SEQUENCE_STARTED", "SEQUENCE_ENDED", "SEQUENCE_ABORTED"])
def test_an_event_of_sequences_starts_no_sequence(flight: Flight, event: str):
    request = packet("START_SEQUENCE", sequence=1)
    values = {**APID, "event": event, "request": request}
    assert flight.refused("ADD_EVENT_ACTION", values) is Error.BAD_ARG
