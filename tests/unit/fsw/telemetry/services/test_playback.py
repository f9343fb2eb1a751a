"""Service 15: stored packets, retrieved by time."""

import errno
import os

import pytest

from fsw.messages import Event
from fsw.telemetry.dictionary.codes import Error, Store
from fsw.telemetry.link.packets import cuc
from fsw.telemetry.services.ground_link import GroundLink
from fsw.telemetry.services.playback import store_of
from fsw.telemetry.state.epoch import Epoch
from tests.support.application_cases import DONE, EPOCH, SECOND, Flight


def when(name: str, t_s: float) -> dict:
    time = cuc(round(t_s * SECOND))
    return {
        f"{name}_p_field": time[0],
        f"{name}_coarse_s": int.from_bytes(time[1:5], "big"),
        f"{name}_fine": int.from_bytes(time[5:], "big"),
    }


def between(store: str, from_s: float, to_s: float) -> dict:
    return {"store": store, **when("from", from_s), **when("to", to_s)}


def play_back(flight: Flight, store: str, from_s: float, to_s: float) -> list[bytes]:
    """Retrieve; return the packets of that store that came, as bytes."""
    told = flight.send("PLAY_BACK", between(store, from_s, to_s))
    assert "start_success" in told
    before = len(flight.raw)
    flight.wait(3.0)
    assert "completion_success" in [p.packet.name for p in flight.packets[-6:]]
    return [raw for raw in flight.raw[before:] if store_of(raw) is Store[store]]


def record(flight: Flight, count: int) -> None:
    """Let housekeeping set 8 go down once a second."""
    for _ in range(count):
        flight.send("REPORT_SET", {"sid": 8})
        flight.wait(1.0)


def test_housekeeping_of_a_time_range_comes_again_byte_for_byte(flight: Flight):
    record(flight, 10)
    was = [raw for raw in flight.raw if store_of(raw) is Store.HOUSEKEEPING]
    assert len(was) == 10
    assert play_back(flight, "HOUSEKEEPING", 1002.5, 1006.5) == was[3:7]
    assert {"PLAYBACK_STARTED", "PLAYBACK_ENDED"} <= set(flight.codes)


def test_what_was_missed_survives_a_restart_of_the_daemon_and_of_the_machine(flight: Flight):
    record(flight, 3)
    was = [raw for raw in flight.raw if store_of(raw) is Store.HOUSEKEEPING]
    rebooted = Epoch(clock_id="second", utc_less_met_ns=EPOCH.utc_less_met_ns + 980 * SECOND)
    for again in (
        Flight(flight.config, now=flight.now),
        Flight(flight.config, now=50 * SECOND, epoch=rebooted),
    ):
        assert play_back(again, "HOUSEKEEPING", 0.0, 5000.0) == was
    again.send("REPORT_STORE_CONTENT", {"store": "HOUSEKEEPING"})
    told = again.last("store_content")
    assert (told["oldest_s"], told["newest_s"]) == pytest.approx((20.0, 22.0), abs=1e-6)


def test_events_and_science_have_stores_of_their_own(flight: Flight):
    flight.send("ENABLE_SET", {"sid": 20})
    flight.send("SET_INTERVAL", {"sid": 20, "interval_ms": 10})
    for k in range(50):
        flight.app.science(1000 * SECOND + k * SECOND // 50, bytes(250))
    flight.app.event(Event(flight.now, "high", "PORT_LOST", "imu"))
    science = play_back(flight, "SCIENCE", 1000.5, 1001.0)
    assert len(science) == 25
    flight.packets.clear()
    play_back(flight, "EVENTS", 0.0, 2000.0)
    assert sum(v["text"] == "imu" for v in flight.all("event_high")) == 1


def test_a_verification_report_never_comes_again(flight: Flight):
    """Its telecommand's sequence count may be a newer one's by then: it would steer the ground."""
    flight.send("PING")
    for store in ("EVENTS", "HOUSEKEEPING", "SCIENCE"):
        came = play_back(flight, store, 0.0, 2000.0)
        assert all(raw[7] != 1 for raw in came)


def test_a_long_retrieval_is_spread_over_polls_and_leaves_the_rest_its_turn(flight: Flight):
    flight.send("ENABLE_SET", {"sid": 20})
    flight.send("SET_INTERVAL", {"sid": 20, "interval_ms": 10})
    for k in range(1000):
        flight.app.science(1000 * SECOND + k * SECOND // 50, bytes(250))
    before = len(flight.raw)
    flight.send("PLAY_BACK", between("SCIENCE", 0.0, 9999.0))
    assert flight.refused("PLAY_BACK", between("SCIENCE", 0.0, 1.0)) is Error.BUSY
    flight.app.poll(flight.now)
    assert 0 < len(flight.raw) - before < 80
    assert flight.send("PING")[2] == "alive"
    assert flight.send("ABORT_PLAYBACK", {"n": 1, "store": "SCIENCE"})[-1] == DONE[-1]
    assert flight.error() is Error.FAILED  # of the retrieval itself
    assert flight.refused("ABORT_PLAYBACK", {"store": "SCIENCE"}) is Error.NOT_STAGED


def test_a_client_without_room_delays_a_retrieval_and_loses_nothing(flight: Flight, monkeypatch):
    record(flight, 5)
    room = [0]
    monkeypatch.setattr(GroundLink, "room_bytes", property(lambda _: room[0]))
    flight.send("PLAY_BACK", between("HOUSEKEEPING", 0.0, 2000.0))
    before = len(flight.all("link"))
    flight.wait(2.0)
    assert len(flight.all("link")) == before
    room[0] = 1 << 16
    flight.wait(0.5)
    assert len(flight.all("link")) == before + 5


def test_storage_is_switched_and_the_switch_survives(flight: Flight):
    assert flight.send("DISABLE_STORE", {"store": "HOUSEKEEPING"}) == DONE
    record(flight, 2)
    flight.send("REPORT_STORE_STATUS")
    assert [v["enabled"] for v in flight.all("store_status")] == [1, 0, 1]
    again = Flight(flight.config)
    again.send("REPORT_STORE_STATUS")
    assert [v["enabled"] for v in again.all("store_status")] == [1, 0, 1]
    again.send("ENABLE_STORE", {"store": "HOUSEKEEPING"})
    record(again, 1)
    again.send("REPORT_STORE_CONTENT", {"store": "HOUSEKEEPING"})
    assert again.last("store_content")["oldest_s"] == again.last("store_content")["newest_s"] > 0


def test_packets_up_to_a_time_are_deleted(flight: Flight):
    record(flight, 3)
    keep = {"n": 1, "store": "HOUSEKEEPING"}
    flight.send("DELETE_STORED", {**when("until", 1001.5), **keep})
    flight.send("REPORT_STORE_CONTENT", {"store": "HOUSEKEEPING"})
    assert flight.last("store_content")["oldest_s"] == 1000.0  # newer ones share the segment
    flight.send("DELETE_STORED", {**when("until", 1002.5), **keep})
    flight.send("REPORT_STORE_CONTENT", {"store": "HOUSEKEEPING"})
    assert flight.last("store_content")["stored_bytes"] == 0
    record(flight, 1)
    flight.send("REPORT_STORE_CONTENT", {"store": "HOUSEKEEPING"})
    assert flight.last("store_content")["oldest_s"] == 1003.0


def test_a_range_that_ends_before_it_begins_is_refused(flight: Flight):
    assert flight.refused("PLAY_BACK", between("EVENTS", 5.0, 4.0)) is Error.OUT_OF_RANGE
    assert flight.refused("PLAY_BACK", between("EVENTS", 0.0, 1.0) | {"store": 9}) is Error.BAD_ARG
    wrong = between("EVENTS", 0.0, 1.0) | {"to_p_field": 0}
    assert flight.refused("PLAY_BACK", wrong) is Error.OUT_OF_RANGE


def test_a_full_disk_is_one_event_and_storing_begins_again(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
):
    record(flight, 1)
    playback = flight.app.onboard.playback
    store = playback._stores[Store.HOUSEKEEPING]

    def full(_packet: bytes) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(store, "append", full)
        record(flight, 15)
    assert flight.codes.count("PACKET_STORE_FAILED") == 1
    record(flight, 15)
    assert flight.codes.count("PACKET_STORE_BACK") == 1
    flight.send("REPORT_STORE_STATUS")
    assert flight.all("store_status")[1]["failed"] >= 15
