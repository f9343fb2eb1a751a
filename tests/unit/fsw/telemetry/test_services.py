"""Every message of services 1, 3, 5, 8, 9 and 17, on a fake host."""

from itertools import pairwise

import pytest

from fsw.errors import ConfigError
from fsw.messages import Event
from fsw.messages.commands import CommandName, JobReport
from fsw.telemetry.dictionary.codes import Error, Health, Mode
from tests.conftest import ArmProject
from tests.support.application_cases import BEGUN, DONE, Flight, flight_config


def test_a_ping_is_answered_between_acceptance_and_completion(flight):
    assert flight.send("PING") == ["acceptance_success", "start_success", "alive", DONE[2]]


def test_only_the_reports_asked_for_come_but_failures_always(flight):
    assert flight.send("PING", ack=0) == ["alive"]
    assert flight.send("PING", ack=0b1001) == ["acceptance_success", "alive", "completion_success"]
    told = flight.send("DELETE_FILE", {"path": "files/none"}, ack=0)
    assert told == ["acceptance_failure", "event_low"]


def test_version(flight):
    assert flight.send("REPORT_VERSION")[2] == "version"
    told = flight.last("version")
    assert told["config_crc32"] == flight.config.crc32
    assert told["boot_count"] == 1
    assert told["python"].startswith("3.")


def test_a_set_once(flight):
    assert flight.send("REPORT_SET", {"sid": 1})[2] == "health"
    told = flight.last("health")
    assert (told["mode"], told["health"], told["tc_accepted"]) == (3, 0, 1)
    for sid, name in ((2, "estimate"), (3, "covariance"), (4, "devices"), (5, "batch")):
        assert flight.send("REPORT_SET", {"sid": sid})[2] == name
    for sid, name in ((6, "tables"), (7, "recorder"), (8, "link")):
        assert flight.send("REPORT_SET", {"sid": sid})[2] == name
    assert flight.last("estimate")["reason"] == 1


def test_a_set_is_enabled_changed_told_and_disabled(flight):
    flight.send("SET_INTERVAL", {"sid": 8, "interval_ms": 500})
    assert flight.send("ENABLE_SET", {"sid": 8}) == DONE
    flight.wait(5.0)
    assert len(flight.all("link")) == 10
    flight.send("REPORT_SET_PROPERTIES", {"sid": 8})
    assert flight.last("set_properties") == {"n": 1, "sid": 8, "periodic": 1, "interval_ms": 500}
    flight.send("DISABLE_SET", {"sid": 8})
    flight.wait(5.0)
    assert len(flight.all("link")) == 10


def test_science_comes_at_its_own_interval_with_the_loops_time(flight):
    flight.send("SET_INTERVAL", {"sid": 20, "interval_ms": 50})
    flight.send("ENABLE_SET", {"sid": 20})
    record = bytes(250)
    for k in range(100):
        flight.app.science(10**9 + k * 10_000_000, record)
    told = [p for p in flight.packets if p.packet.name == "science"]
    assert len(told) == 20
    assert {(b.t_ns - a.t_ns) // 1000 for a, b in pairwise(told)} <= {
        49_999,
        50_000,
    }


def test_science_faster_than_the_loop_hands_samples_over_is_refused(arm: ArmProject):
    flight = Flight(flight_config(arm, science_rate_hz=50.0))
    flight.up()
    fast = {"sid": 20, "interval_ms": 19}
    assert flight.refused("SET_INTERVAL", fast) is Error.OUT_OF_RANGE
    assert flight.last("acceptance_failure")["error_argument"] == 3
    assert flight.send("SET_INTERVAL", {"sid": 20, "interval_ms": 20}) == DONE
    assert flight.send("SET_INTERVAL", {"sid": 1, "interval_ms": 10}) == DONE


def test_a_science_interval_shorter_than_the_loops_is_no_configuration(arm: ArmProject):
    with pytest.raises(ConfigError, match=r"0\.009 must be 0, or at least 0\.01"):
        flight_config(arm, science_interval_s=0.009)


def test_events_go_out_by_severity_with_their_own_time(flight):
    for severity in ("info", "low", "medium", "high"):
        flight.app.event(Event(5 * 10**9, severity, "STOPPED", f"{severity} words"))
        told = flight.packets[-1]
        assert (told.packet.name, told.t_ns) == (f"event_{severity}", 5 * 10**9)
        assert told.values["text"] == f"{severity} words"
    assert told.values["occurrence"] == 4


def test_an_event_without_a_number_is_told_by_its_code(flight):
    flight.app.event(Event(0, "low", "NOBODY_KNOWS", "words"))
    assert flight.last("event_low")["event"] == 65535
    assert flight.last("event_low")["text"] == "NOBODY_KNOWS: words"


def test_an_event_is_disabled_told_so_and_enabled(flight):
    stopped = {"event": "STOPPED"}
    assert flight.send("DISABLE_EVENT", stopped) == DONE
    flight.app.event(Event(0, "info", "STOPPED", ""))
    assert [told["event"] for told in flight.all("event_info")] == [50]  # into IDENTIFY
    flight.send("REPORT_DISABLED_EVENTS")
    assert (flight.last("disabled_events")["n"], flight.last("disabled_events")["event_1"]) == (
        1,
        2,
    )
    flight.send("ENABLE_EVENT", stopped)
    flight.app.event(Event(0, "info", "STOPPED", ""))
    assert flight.last("event_info")["suppressed"] == 1
    flight.send("REPORT_DISABLED_EVENTS")
    assert flight.last("disabled_events")["n"] == 0


def test_a_flood_of_one_event_is_throttled_and_counted(flight):
    for k in range(100):
        flight.app.event(Event(k * 10**8, "low", "REALTIME", ""))
    told = flight.all("event_low")
    assert len(told) == 10  # ten within ten seconds
    flight.app.event(Event(10**10, "low", "REALTIME", ""))
    assert flight.last("event_low")["suppressed"] == 90
    assert flight.app.events.total == 101 + 1  # and the one into IDENTIFY


def test_the_event_log_is_dumped_oldest_first(flight):
    assert flight.send("EVENT_LOG_DUMP", {"entries": 5}) == [*BEGUN, "event_log_entry", DONE[2]]
    assert flight.last("event_log_entry")["text"] == "BOOT to IDENTIFY"
    for k in range(7):
        flight.app.event(Event(k * 10**9, "info", "STOPPED", f"{k}"))
    flight.packets.clear()
    flight.send("EVENT_LOG_DUMP", {"entries": 3})
    told = flight.all("event_log_entry")
    assert [(t["entry"], t["entries"], t["text"]) for t in told] == [
        (1, 3, "4"),
        (2, 3, "5"),
        (3, 3, "6"),
    ]


def test_time_packets_come_at_the_commanded_rate(flight):
    flight.wait(33.0)
    assert len(flight.all("time")) == 3
    flight.send("SET_TIME_REPORT_RATE", {"exponent": 1})
    flight.packets.clear()
    flight.wait(8.0)
    told = flight.all("time")
    assert 4 <= len(told) <= 5
    assert told[-1]["coarse_s"] == flight.packets[-1].t_ns // 10**9


def test_counters_and_health_are_reset_by_command(flight):
    flight.app.event(Event(flight.now, "high", "ESTIMATOR_RESET", "diverged"))
    assert flight.app.supervision.health.latched == 1 << Health.ESTIMATOR_RESET
    flight.send("RESET_COUNTERS")
    flight.send("REPORT_SET", {"sid": 1})
    told = flight.last("health")
    assert (told["tc_accepted"], told["events"]) == (1, 0)
    assert told["health"] == 1 << Health.ESTIMATOR_RESET
    flight.send("CLEAR_HEALTH", {"mask": 0xFFFFFFFF})
    assert flight.app.supervision.health.latched == 0


def test_what_the_loop_does_completes_when_it_says_so(flight):
    for name, command in (
        ("RESET_ESTIMATOR", CommandName.RESET),
        ("SETTLE_ESTIMATOR", CommandName.FINISH),
        ("SAVE_STATE", CommandName.SAVE_STATE),
        ("RESTORE_STATE", CommandName.RESTORE_STATE),
        ("ADOPT_RESULT", CommandName.ADOPT),
        ("ABORT_BATCH", CommandName.ABORT_BATCH),
    ):
        assert flight.send(name) == BEGUN
        assert flight.commands[0].name is command
        flight.answer()
        assert flight.packets[-1].packet.name == "completion_success"


def test_identification_is_started_for_other_bodies_and_stopped(flight):
    assert flight.send("START_IDENTIFICATION", {"unknown": "BOTH"}) == BEGUN
    assert flight.commands[0].name is CommandName.CONFIGURE
    assert flight.commands[0].args == {"unknown": ["base", "target"]}
    flight.answer()
    assert flight.commands[0].name is CommandName.RESUME
    flight.answer()
    assert flight.packets[-1].packet.name == "completion_success"
    flight.send("STOP_IDENTIFICATION")
    flight.answer()
    assert flight.app.mode_machine.mode is Mode.STANDBY


def test_the_diagnosis_comes_before_its_completion(flight):
    flight.send("REPORT_DIAGNOSIS")
    flight.answer(
        verdict={"base": "good", "target": "good to 1 %"},
        blocks=7,
        innovation_lag1={"correlation": 0.5},
        parameters={
            "target": {
                "mass_kg": "measured",
                "com_m": ["measured"] * 3,
                "inertia_kg_m2": ["measured"] * 5 + ["prior-dominated"],
            }
        },
    )
    assert [p.packet.name for p in flight.packets[-2:]] == ["diagnosis", "completion_success"]
    assert flight.last("diagnosis")["verdict"] == "good; good to 1 %"
    assert flight.last("diagnosis")["innovation_lag1"] == 0.5
    told = flight.last("diagnosis")["parameters"]
    assert told.startswith("target: measured: mass x y z")
    assert told.endswith("prior-dominated: Izz")


def test_a_batch_job_is_followed_to_its_end(flight):
    assert flight.send("RUN_BATCH", {"method": "RDA", "unknown": "TARGET", "last_s": 30.0}) == BEGUN
    command = flight.commands[0]
    assert command.args == {"method": "rda", "unknown": ["target"], "last_s": 30.0}
    flight.answer()
    assert flight.app.mode_machine.mode is Mode.BATCH
    for done in (0.02, 0.3, 0.31, 0.9):
        flight.app.job(JobReport(id=command.id, state="running", progress=done, text="step"))
    assert [v["step"] for v in flight.all("progress_success")] == [30, 90]
    result = {"method": "rda", "unknown": ["target"], "status": "OK", "cost": 5.0}
    flight.app.job(JobReport(id=command.id, state="done", progress=1.0, result=result))
    assert flight.app.mode_machine.mode is Mode.IDENTIFY
    names = [p.packet.name for p in flight.packets]
    assert "completion_success" in names
    flight.send("REPORT_SET", {"sid": 5})
    told = flight.last("batch")
    assert (told["state"], told["result_status"], told["cost"], told["unknown"]) == (2, 1, 5.0, 2)


def test_a_planned_motion_is_followed_like_a_batch_job(flight):
    asked = {"duration_s": 20.0, "starts": 2, "seed": 7}
    assert flight.send("RUN_PLAN", asked) == BEGUN
    command = flight.commands[0]
    assert (command.name, command.args) == ("run_plan", asked)
    flight.answer()
    assert flight.app.mode_machine.mode is Mode.BATCH
    flight.app.job(JobReport(id=command.id, state="running", progress=0.4, text="start 1 of 2"))
    assert [v["step"] for v in flight.all("progress_success")] == [40]
    ten = {"mass_kg": 0.5, "com_m": [0.1] * 3, "inertia_kg_m2": [0.2] * 6}
    bodies = {"estimate": {"target": ten}, "sigma": {"target": ten}}
    result = {"method": "plan", "unknown": ["target"], "status": "OK", **bodies}
    flight.app.job(JobReport(id=command.id, state="done", progress=1.0, result=result))
    assert flight.packets[-1].packet.name == "completion_success"
    flight.send("REPORT_SET", {"sid": 5})
    told = flight.last("batch")
    assert (told["method"], told["result_status"], told["target_sigma_mass_kg"]) == (6, 1, 0.5)


def test_recordings_are_begun_and_closed(flight):
    assert flight.send("REC_START") == DONE
    assert flight.recording.on
    assert flight.send("REC_STOP") == DONE
    assert not flight.recording.on


def test_a_restart_needs_its_key_and_reaches_the_loop(flight):
    flight.up(identifying=False)
    assert flight.refused("RESTART", {"key": 1}) is Error.OUT_OF_RANGE
    flight.send("RESTART", {"key": 0xB007})
    assert flight.commands[0].name is CommandName.RESTART
