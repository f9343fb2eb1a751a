"""Modes, health, command loss, silence, monitors and the schedule."""

import zlib

import pytest

from fsw.messages import Event
from fsw.messages.commands import CommandName, JobReport
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error, Health, Mode
from fsw.telemetry.link.packets import cuc, telecommand_packet
from tests.conftest import ArmProject
from tests.support.application_cases import DONE, SECOND, Flight, flight_config
from tests.unit.fsw.telemetry.services.test_parameters import set_values

PING = telecommand_packet(DICTIONARY.telecommand("PING"), {}, 4000)


def at(seconds: float, flight: Flight, packet: bytes = PING) -> dict:
    """Arguments that insert a telecommand so many seconds ahead."""
    time = cuc(flight.now + round(seconds * SECOND))
    return {
        "release_p_field": time[0],
        "release_coarse_s": int.from_bytes(time[1:5], "big"),
        "release_fine": int.from_bytes(time[5:8], "big"),
        "telecommand": packet,
    }


class TestModes:
    def test_before_the_loop_speaks_it_is_boot(self, arm: ArmProject):
        flight = Flight(flight_config(arm))
        assert flight.app.mode_machine.mode is Mode.BOOT
        assert flight.refused("START_IDENTIFICATION", {"unknown": 0}) is Error.WRONG_MODE
        assert flight.refused("SET_MODE", {"mode": "SAFE"}) is Error.WRONG_MODE

    def test_a_mode_is_what_is_so_not_what_was_asked_for(self, flight: Flight):
        flight.send("SET_MODE", {"mode": "STANDBY"})
        assert flight.app.mode_machine.mode is Mode.IDENTIFY
        flight.answer()
        assert flight.app.mode_machine.mode is Mode.STANDBY
        flight.up(identifying=False)  # the summary behind the reply
        flight.up(identifying=True)  # somebody at the local socket
        assert flight.app.mode_machine.mode is Mode.IDENTIFY
        flight.app.job(JobReport(id=3, state="running", progress=0.1))
        assert flight.app.mode_machine.mode is Mode.BATCH
        flight.app.job(JobReport(id=3, state="failed", progress=0.1))
        assert flight.codes.count("MODE_CHANGED") == 5

    def test_safe_stops_everything_and_only_a_command_leaves_it(self, flight: Flight):
        assert "completion_success" in flight.send("SET_MODE", {"mode": "SAFE"})
        assert [c.name for c in flight.commands] == [CommandName.REST, CommandName.ABORT_BATCH]
        flight.commands.clear()
        flight.up(identifying=False)
        assert flight.app.mode_machine.mode is Mode.SAFE
        assert flight.refused("START_IDENTIFICATION", {"unknown": 0}) is Error.WRONG_MODE
        flight.send("SET_MODE", {"mode": "IDENTIFY"})
        assert flight.commands[0].name is CommandName.RESUME
        flight.answer()
        assert flight.app.mode_machine.mode is Mode.IDENTIFY

    def test_a_daemon_that_starts_safe_stays_safe_though_a_state_was_identifying(
        self, arm: ArmProject
    ):
        flight = Flight(flight_config(arm, start_mode="safe"))
        flight.up(identifying=True)
        assert flight.commands[0].name is CommandName.REST
        assert flight.app.mode_machine.mode is Mode.SAFE


class TestHealth:
    def test_a_bit_is_latched_until_cleared_and_not_cleared_while_it_stands(self, flight: Flight):
        flight.up(links={"imu": {"up": False}})
        mask = 1 << Health.PORT_LOST
        assert flight.app.supervision.health.latched == mask
        flight.send("CLEAR_HEALTH", {"mask": 0xFFFFFFFF})
        assert flight.app.supervision.health.latched == mask
        flight.up(links={"imu": {"up": True}})
        assert flight.app.supervision.health.latched == mask
        flight.send("CLEAR_HEALTH", {"mask": mask})
        assert flight.app.supervision.health.latched == 0

    @pytest.mark.parametrize(
        ("status", "bit"),
        [
            ({"health": {"faulty": {"axis1": ["TORQUE_STUCK"]}}}, Health.SENSOR_FAULT),
            ({"health": {"faulty": {"imu": ["IMU_SILENT"]}}}, Health.SENSOR_FAULT),
            ({"health": {"faulty": {"arm": ["BUS_OFF"]}}}, Health.BUS),
            ({"samples": {"imu": {"rejected": 3}}}, Health.SENSOR_REJECTED),
            ({"slips": 1}, Health.SLIPS),
        ],
        ids=lambda value: getattr(value, "name", None),
    )
    def test_what_the_loop_finds_wrong_sets_its_bit_and_stands_as_long_as_it_lasts(
        self, flight: Flight, status, bit
    ):
        health = flight.app.supervision.health
        flight.up(**status)
        flight.wait(0.1)
        assert (health.latched, health.now) == (1 << bit, 1 << bit)
        counted = {key: status[key] for key in status if key != "health"}
        flight.wait(11.0)
        flight.up(**counted)
        flight.wait(0.1)
        assert health.latched & 1 << bit
        assert not health.now & 1 << bit

    def test_a_single_spike_or_lost_sample_is_no_fault_of_the_sensor(self, flight: Flight):
        flight.up(health={"faulty": {"axis1": ["TORQUE_SPIKE", "JOINT_LOST"]}})
        assert flight.app.supervision.health.latched == 0

    def test_a_silent_loop_is_told_once(self, flight: Flight):
        flight.wait(10.0)
        assert flight.codes.count("LOOP_SILENT") == 1
        assert flight.app.supervision.health.now & 1 << Health.LOOP_SILENT
        flight.up()
        assert not flight.app.supervision.health.now & 1 << Health.LOOP_SILENT

    def test_an_unclean_end_shows_at_the_next_start(self, flight: Flight):
        crashed = Flight(flight.config)
        assert (crashed.app.context.boot.count, crashed.app.context.boot.cause) == (2, 3)
        crashed.app.close()
        stopped = Flight(flight.config)
        assert (stopped.app.context.boot.count, stopped.app.context.boot.cause) == (3, 1)
        resumed = Flight(flight.config, resume=True)
        assert (resumed.app.context.boot.count, resumed.app.context.boot.cause) == (3, 1)


class TestCommandLoss:
    def test_silence_of_the_ground_leads_to_safe_and_a_command_is_told(self, flight: Flight):
        set_values(flight, {1: 30.0})
        flight.wait(29.0)
        flight.up()
        assert flight.app.mode_machine.mode is Mode.IDENTIFY
        flight.app.supervision.commanded()
        flight.wait(31.0)
        assert flight.app.mode_machine.mode is Mode.SAFE
        assert flight.codes.count("COMMAND_LOSS") == 1
        flight.app.supervision.commanded()
        assert flight.codes[-1] == "COMMAND_BACK"
        assert flight.app.mode_machine.mode is Mode.SAFE


MONITORS = b"""
monitors:
  - {id: 1, value: health.slips, high: 10.0, repetitions: 3, action: safe}
  - {id: 2, value: estimate.blocks, low: 1.0, repetitions: 1, stale_s: 5.0}
  - {id: 3, value: health.tc_rejected, high: 0.0, repetitions: 1, enabled: false}
"""


class TestMonitors:
    @pytest.fixture
    def watched(self, flight: Flight) -> Flight:
        flight.up(identifying=False)
        values = {"table": "MONITORS", "size_bytes": len(MONITORS)}
        flight.send("TBL_LOAD", values | {"crc32": zlib.crc32(MONITORS)})
        flight.send("TBL_DATA", {"table": "MONITORS", "offset": 0, "data": MONITORS})
        flight.send("TBL_VALIDATE", {"table": "MONITORS"})
        activate = {"table": "MONITORS", "crc32": zlib.crc32(MONITORS)}
        assert "completion_success" in flight.send("TBL_ACTIVATE", activate)
        flight.up()
        return flight

    def test_a_limit_tells_after_so_many_in_a_row_and_acts_once(self, watched: Flight):
        watched.send("DISABLE_MONITOR", {"monitor": 2})
        watched.up(slips=11)
        watched.wait(0.4)
        assert watched.all("check_transition") == []
        watched.wait(0.4)
        told = watched.last("check_transition")
        assert (told["monitor"], told["found"], told["limit"], told["now"]) == (1, 11.0, 10.0, 3)
        assert watched.app.mode_machine.mode is Mode.SAFE
        watched.send("SET_MODE", {"mode": "STANDBY"})
        watched.commands = watched.commands[-1:]
        watched.answer()
        watched.up(slips=0)
        watched.wait(0.4)
        assert watched.codes[-1] == "LIMIT_RECOVERED"
        watched.up(slips=20)
        watched.wait(1.0)
        assert watched.codes.count("LIMIT_VIOLATED") == 2
        assert watched.codes.count("LIMIT_ACTION") == 1
        assert watched.app.mode_machine.mode is not Mode.SAFE

    def test_what_was_never_heard_is_stale(self, watched: Flight):
        watched.wait(0.4)
        assert watched.last("check_transition")["now"] == 4

    def test_monitors_are_told_switched_and_unknown_ones_refused(self, watched: Flight):
        watched.send("REPORT_MONITOR", {"monitor": 1})
        told = watched.last("monitor_definition")
        assert (told["high"], told["repetitions"], told["action"]) == (10.0, 3, "safe")
        assert watched.send("ENABLE_MONITOR", {"monitor": 3}) == DONE
        watched.packets.clear()
        watched.send("REPORT_MONITOR_STATUS")
        assert [t["enabled"] for t in watched.all("monitor_status")] == [1, 1, 1]
        assert watched.refused("ENABLE_MONITOR", {"monitor": 9}) is Error.BAD_ARG
        watched.send("DISABLE_MONITORING")
        watched.up(slips=99)
        watched.wait(2.0)
        assert watched.all("check_transition") == []
        watched.send("ENABLE_MONITORING")
        watched.wait(2.0)
        assert watched.all("check_transition")

    def test_without_monitors_the_status_says_so(self, flight: Flight):
        flight.send("REPORT_MONITOR_STATUS")
        assert flight.last("monitor_status")["n"] == 0


class TestSchedule:
    def test_a_command_waits_for_its_time(self, flight: Flight):
        assert flight.send("INSERT_ACTIVITY", at(5.0, flight)) == DONE
        flight.send("REPORT_SCHEDULE")
        told = flight.last("schedule_entry")
        assert (told["n"], told["apid"], told["service"]) == (1, 100, 17)
        flight.wait(4.9)
        assert flight.all("alive") == []
        flight.wait(0.3)
        assert len(flight.all("alive")) == 1
        flight.send("REPORT_SCHEDULE")
        assert flight.last("schedule_entry")["n"] == 0

    def test_a_whole_second_is_told_as_one(self, flight: Flight):
        """In floating point 1020 e9 ns times 1e-9 is another number than 1020."""
        assert 1020 * SECOND * 1e-9 != 1020.0
        flight.send("INSERT_ACTIVITY", at(20.0, flight))
        flight.send("REPORT_SCHEDULE")
        assert flight.last("schedule_entry")["release_time_s"] == 1020.0

    def test_what_comes_due_while_disabled_is_discarded(self, flight: Flight):
        flight.send("DISABLE_SCHEDULE")
        flight.send("INSERT_ACTIVITY", at(1.0, flight))
        flight.wait(2.0)
        assert flight.all("alive") == []
        assert flight.app.onboard.schedule.discarded == 1
        flight.send("ENABLE_SCHEDULE")
        flight.send("INSERT_ACTIVITY", at(1.0, flight))
        flight.wait(2.0)
        assert len(flight.all("alive")) == 1

    def test_one_is_deleted_or_all(self, flight: Flight):
        flight.send("INSERT_ACTIVITY", at(5.0, flight))
        wanted = {"source_id": 0, "apid": 100, "sequence_count": 4000}
        assert "completion_success" in flight.send("DELETE_ACTIVITY", wanted)
        assert flight.refused("DELETE_ACTIVITY", wanted) is Error.BAD_ARG
        flight.send("INSERT_ACTIVITY", at(5.0, flight))
        flight.send("RESET_SCHEDULE")
        assert flight.app.onboard.schedule.entries == 0

    def test_what_cannot_be_kept_is_refused(self, flight: Flight):
        assert flight.refused("INSERT_ACTIVITY", at(-1.0, flight)) is Error.OUT_OF_RANGE
        assert flight.refused("INSERT_ACTIVITY", at(5.0, flight, PING[:-1])) is Error.BAD_LENGTH
        damaged = PING[:-1] + bytes((PING[-1] ^ 1,))
        assert flight.refused("INSERT_ACTIVITY", at(5.0, flight, damaged)) is Error.BAD_CRC
        own = telecommand_packet(DICTIONARY.telecommand("RESET_SCHEDULE"), {}, 9)
        assert flight.refused("INSERT_ACTIVITY", at(5.0, flight, own)) is Error.BAD_ARG
        flight.send("INSERT_ACTIVITY", at(5.0, flight))
        assert flight.refused("INSERT_ACTIVITY", at(6.0, flight)) is Error.BAD_ARG
        for k in range(63):
            packet = telecommand_packet(DICTIONARY.telecommand("PING"), {}, 5000 + k)
            flight.send("INSERT_ACTIVITY", at(7.0, flight, packet))
        late = telecommand_packet(DICTIONARY.telecommand("PING"), {}, 6000)
        assert flight.refused("INSERT_ACTIVITY", at(8.0, flight, late)) is Error.BUSY

    def test_modes_are_looked_at_when_it_is_released(self, flight: Flight):
        start = telecommand_packet(
            DICTIONARY.telecommand("START_IDENTIFICATION"), {"unknown": 0}, 4001
        )
        assert flight.send("INSERT_ACTIVITY", at(1.0, flight, start)) == DONE
        flight.app.event(Event(0, "info", "STOPPED", ""))
        flight.app.mode_machine.latch_safe()
        flight.wait(2.0)
        assert flight.error() is Error.WRONG_MODE
