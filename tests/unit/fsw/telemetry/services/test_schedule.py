"""Service 11 over restarts: what waits is kept, shifted, reported, and never released twice."""

import errno
import os
from pathlib import Path

import pytest
from fastcrc import crc16

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import telecommand_packet
from fsw.telemetry.services.schedule import FOLDER
from fsw.telemetry.state.epoch import Epoch, carried_over
from tests.support.application_cases import DONE, EPOCH, SECOND, Flight
from tests.unit.fsw.telemetry.test_reactions import at

NO_OFFSET = {"offset_coarse_s": 0, "offset_fine": 0}


def ping(count: int) -> bytes:
    return telecommand_packet(DICTIONARY.telecommand("PING"), {}, count)


def restarted(flight: Flight, *, after_s: float = 0.0, epoch: Epoch = EPOCH) -> Flight:
    """The daemon again on the same state directory, as after a kill."""
    again = Flight(flight.config, now=flight.now + round(after_s * SECOND), epoch=epoch)
    again.up()
    return again


def times(flight: Flight) -> list[float]:
    """Report the schedule; return the times of release."""
    flight.packets.clear()
    flight.send("REPORT_SCHEDULE")
    return [t["release_time_s"] for t in flight.all("schedule_entry") if t["n"]]


def test_what_waits_survives_a_restart_and_is_released_once(flight: Flight):
    flight.send("INSERT_ACTIVITY", at(20.0, flight, ping(2)))
    flight.send("INSERT_ACTIVITY", at(10.0, flight, ping(1)))
    again = restarted(flight, after_s=5.0)
    assert again.codes.count("SCHEDULE_RESTORED") == 1
    assert times(again) == [1010.0, 1020.0]
    again.wait(5.1)
    assert len(again.all("alive")) == 1
    third = restarted(again)
    third.wait(9.0)
    assert len(third.all("alive")) == 0
    third.wait(2.0)
    assert len(third.all("alive")) == 1


def test_a_little_late_is_released_after_the_restart_and_much_is_discarded(flight: Flight):
    flight.send("INSERT_ACTIVITY", at(10.0, flight, ping(1)))
    flight.send("INSERT_ACTIVITY", at(2.0, flight, ping(2)))
    again = restarted(flight, after_s=12.0)
    assert again.codes.count("SCHEDULE_DISCARDED") == 1
    assert again.app.onboard.schedule.discarded == 1
    again.wait(0.1)
    assert len(again.all("alive")) == 1


def test_after_a_restart_of_the_machine_the_time_of_day_connects_the_clocks(flight: Flight):
    flight.send("INSERT_ACTIVITY", at(600.0, flight, ping(1)))
    rebooted = Epoch(clock_id="second", utc_less_met_ns=EPOCH.utc_less_met_ns + 1100 * SECOND)
    again = Flight(flight.config, now=20 * SECOND, epoch=rebooted)  # 120 s later
    assert times(again) == [500.0]
    assert carried_over(5, EPOCH, EPOCH) == 5
    assert carried_over(5, rebooted, EPOCH) == 1100 * SECOND + 5


def test_the_switch_survives_too(flight: Flight):
    flight.send("INSERT_ACTIVITY", at(5.0, flight, ping(1)))
    flight.send("DISABLE_SCHEDULE")
    again = restarted(flight)
    assert not again.app.onboard.schedule.enabled
    again.wait(6.0)
    assert again.all("alive") == []


def test_one_is_shifted_or_all(flight: Flight):
    for count in (1, 2):
        flight.send("INSERT_ACTIVITY", at(10.0 * count, flight, ping(count)))
    one = {"source_id": 0, "apid": 100, "sequence_count": 1}
    shift = {"offset_coarse_s": 30, "offset_fine": 1 << 23}
    assert flight.send("SHIFT_ACTIVITY", one | shift) == DONE
    assert times(flight) == [1020.0, 1040.5]
    assert flight.send("SHIFT_SCHEDULE", {"offset_coarse_s": -11, "offset_fine": 0}) == DONE
    assert times(flight) == [1009.0, 1029.5]
    assert times(restarted(flight)) == [1009.0, 1029.5]


def test_a_shift_into_the_past_moves_none(flight: Flight):
    for count in (1, 2):
        flight.send("INSERT_ACTIVITY", at(10.0 * count, flight, ping(count)))
    past = {"offset_coarse_s": -11, "offset_fine": 0}
    assert flight.refused("SHIFT_SCHEDULE", past) is Error.OUT_OF_RANGE
    assert times(flight) == [1010.0, 1020.0]
    far = {"offset_coarse_s": 400 * 86_400, "offset_fine": 0}
    assert flight.refused("SHIFT_SCHEDULE", far) is Error.OUT_OF_RANGE
    nobody = {"source_id": 0, "apid": 100, "sequence_count": 9}
    assert flight.refused("SHIFT_ACTIVITY", nobody | NO_OFFSET) is Error.BAD_ARG
    other = {"source_id": 7, "apid": 100, "sequence_count": 1}
    assert flight.refused("SHIFT_ACTIVITY", other | NO_OFFSET) is Error.BAD_ARG


def test_the_telecommands_themselves_are_reported(flight: Flight):
    flight.send("REPORT_SCHEDULE_DETAIL")
    assert flight.last("schedule_detail")["n"] == 0
    flight.send("INSERT_ACTIVITY", at(10.0, flight, ping(1)))
    flight.send("REPORT_SCHEDULE_DETAIL")
    assert bytes.fromhex(flight.last("schedule_detail")["request_hex"]) == ping(1)


def test_a_telecommand_too_long_to_be_kept_is_refused(flight: Flight):
    data = {"table": "NOISE", "offset": 0, "data": bytes(300)}
    long = telecommand_packet(DICTIONARY.telecommand("TBL_DATA"), data, 1)
    assert flight.refused("INSERT_ACTIVITY", at(9.0, flight, long)) is Error.BAD_LENGTH


def test_a_disk_that_is_full_changes_nothing(flight: Flight, monkeypatch: pytest.MonkeyPatch):
    flight.send("INSERT_ACTIVITY", at(10.0, flight, ping(1)))

    def fail(_fd: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("file_delivery.durable.os.fsync", fail)
    for name, values in (
        ("INSERT_ACTIVITY", at(20.0, flight, ping(2))),
        ("SHIFT_SCHEDULE", {"offset_coarse_s": 5, "offset_fine": 0}),
        ("RESET_SCHEDULE", {}),
        ("DISABLE_SCHEDULE", {}),
    ):
        assert "completion_failure" in flight.send(name, values)
        assert flight.error() is Error.FAILED
    assert times(flight) == [1010.0]
    flight.wait(10.1)
    assert len(flight.all("alive")) == 1  # released all the same


def test_what_was_released_on_a_full_disk_is_not_released_again_after_a_crash(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
):
    flight.send("INSERT_ACTIVITY", at(10.0, flight, ping(1)))
    flight.send("INSERT_ACTIVITY", at(11.0, flight, ping(2)))

    def fail(_source: Path, _target: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("file_delivery.durable.rename_file", fail)  # no new file
    monkeypatch.setattr("fsw.telemetry.state.store.rename_file", fail)
    flight.wait(10.5)
    assert len(flight.all("alive")) == 1
    again = restarted(flight)
    again.wait(0.4)
    assert len(again.all("alive")) == 0
    again.wait(0.2)
    assert len(again.all("alive")) == 1


def test_damaged_documents_give_way_to_older_ones_and_never_stop_the_start(flight: Flight):
    flight.send("INSERT_ACTIVITY", at(10.0, flight, ping(1)))
    folder = flight.app.onboard.schedule._store.directory
    assert folder.name == FOLDER
    flight.app.onboard.schedule._store.write(b'{"enabled": true, "entries": [{"packet": 3}]}')
    flight.app.onboard.schedule._store.write(b"[" * 4000)
    again = restarted(flight)
    assert "STORED_REQUESTS_CORRUPT" in again.codes
    assert times(again) == [1010.0]


def test_an_n_other_than_1_is_refused(flight: Flight):
    """The standard repeats the group N times; here one telecommand names one object."""
    good = telecommand_packet(DICTIONARY.telecommand("DELETE_MONITOR"), {"monitor": 3}, 1)
    assert good[11] == 1
    wrong = good[:11] + b"\x02" + good[12:-2]
    flight.app.executor.receive(wrong + crc16.ibm_3740(wrong).to_bytes(2, "big"))
    assert flight.error() is Error.OUT_OF_RANGE


def test_what_is_stored_beyond_the_capacity_is_discarded_and_reported(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
):
    for count in (1, 2):
        flight.send("INSERT_ACTIVITY", at(10.0 * count, flight, ping(count)))
    monkeypatch.setattr("fsw.telemetry.services.schedule.CAPACITY", 1)
    again = restarted(flight)
    assert times(again) == [1010.0]
    assert again.codes.count("SCHEDULE_DISCARDED") == 1
    assert again.app.onboard.schedule.discarded == 1
