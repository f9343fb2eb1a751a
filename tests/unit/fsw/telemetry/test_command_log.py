"""Every command leaves its trace: who, when, what, outcome; and the security log beside it."""

import json

import pytest

from fsw.config.tables import MonitorConfig, MonitorsTable
from fsw.messages.commands import Code, Command, CommandName, Reply
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import CommandOutcome, Error
from fsw.telemetry.link.packets import telecommand_packet
from fsw.telemetry.link.splitter import Uplinked
from fsw.telemetry.state.command_log import CAPACITY
from fsw.telemetry.state.fair_log import FairLog
from fsw.telemetry.state.journal import Journal
from tests.support.application_cases import SECOND, Flight, flight_config
from tests.unit.fsw.telemetry.services.test_parameters import set_values


def give(flight: Flight, name: str, values: dict | None = None, *, number: int = 1) -> None:
    """Give a telecommand as a client sends it."""
    packet = telecommand_packet(DICTIONARY.telecommand(name), values or {}, 1000 + number)
    flight.app.receive(Uplinked(packet=packet, source="10.0.0.7:4242 SPI 3"), flight.now)


def dumped(flight: Flight, name: str = "COMMAND_LOG_DUMP", packet: str = "command_log_entry"):
    """Dump a log; return its entries."""
    before = len(flight.all(packet))
    flight.send(name, {"entries": 1000})
    for _ in range(60):
        flight.now += SECOND
        flight.app.poll(flight.now)
    return flight.all(packet)[before:]


def test_a_command_is_logged_with_sender_time_arguments_and_outcome(flight):
    give(flight, "ENABLE_SET", {"sid": 2})
    entry = dumped(flight)[0]
    assert (entry["who"], entry["command"]) == ("10.0.0.7:4242 SPI 3", "ENABLE_SET")
    assert entry["arguments"] == "sid=ESTIMATE"
    assert (entry["outcome"], entry["error"]) == (CommandOutcome.COMPLETED, Error.NONE)
    assert entry["time_s"] == pytest.approx(1000.0)
    assert entry["boot_count"] == flight.app.context.boot.count
    (event,) = [e for e in flight.events if e.code == "TC_COMPLETED" and "ENABLE" in e.text]
    assert event.text == "ENABLE_SET sid=ESTIMATE (10.0.0.7:4242 SPI 3)"
    assert event.severity == "info"


def test_what_takes_time_is_logged_when_it_is_accepted_and_when_it_ends(flight):
    give(flight, "RESET_ESTIMATOR")
    assert flight.codes[-1] == "TC_ACCEPTED"
    assert dumped(flight)[0]["outcome"] == CommandOutcome.ACCEPTED
    assert dumped(flight)[0]["outcome"] == CommandOutcome.FAILED, "the loop did not answer in time"
    give(flight, "RESET_ESTIMATOR", number=2)
    flight.commands.clear()
    give(flight, "RESET_ESTIMATOR", number=3)
    flight.now += SECOND // 4
    flight.answer()
    assert flight.codes[-1] == "TC_COMPLETED"
    entry = [e for e in dumped(flight) if e["command"] == "RESET_ESTIMATOR"][2]
    assert entry["outcome"] == CommandOutcome.COMPLETED
    assert entry["duration_s"] == pytest.approx(0.25)


def test_failures_and_rejections_are_logged_with_their_error(flight):
    give(flight, "SAVE_STATE")
    flight.answer(Code.NO_STATE, "nothing")
    give(flight, "DELETE_FILE", {"path": "files/none"}, number=2)
    entries = dumped(flight)
    assert [(e["outcome"], Error(e["error"])) for e in entries[:2]] == [
        (CommandOutcome.FAILED, Error.NOT_STAGED),
        (CommandOutcome.REJECTED, Error.FILE_NOT_FOUND),
    ]
    assert entries[1]["arguments"] == "path=files/none"
    texts = [e.text for e in flight.events if e.code in ("TC_FAILED", "TC_REJECTED")]
    assert all("10.0.0.7:4242 SPI 3" in text for text in texts)
    assert len(texts) == 2


def test_commands_of_the_local_socket_are_logged_too(flight):
    flight.app.local_command(Command(name=CommandName.RESET, id=7))
    flight.app.reply(Reply(id=7, command="reset", accepted=True, code=Code.ACCEPTED))
    flight.app.local_command(Command(name=CommandName.ADOPT, id=8))
    flight.app.reply(Reply(id=8, command="adopt", accepted=False, code=Code.NO_RESULT))
    entries = dumped(flight)
    assert [(e["who"], e["command"], e["outcome"]) for e in entries[:2]] == [
        ("local socket", "RESET", CommandOutcome.COMPLETED),
        ("local socket", "ADOPT", CommandOutcome.FAILED),
    ]


def test_the_history_survives_a_restart(arm):
    config = flight_config(arm)
    flight = Flight(config)
    flight.up()
    give(flight, "PING")
    give(flight, "RESET_ESTIMATOR", number=2)  # and no answer: the daemon ends before
    first = flight.app.context.boot.count
    flight.app.close()
    path = config.resolve(config.service.state_directory) / "commands.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["outcome"] for line in lines] == ["COMPLETED", "ACCEPTED"]
    with path.open("a") as file:
        file.write('{"who": 1}\n[]\n{"cut')
    again = Flight(config)
    again.up()
    give(again, "PING", number=3)
    entries = dumped(again)
    assert [(e["command"], e["outcome"], e["boot_count"] - first) for e in entries[:3]] == [
        ("PING", CommandOutcome.COMPLETED, 0),
        ("RESET_ESTIMATOR", CommandOutcome.INTERRUPTED, 0),
        ("PING", CommandOutcome.COMPLETED, 1),
    ]
    again.app.close()


def test_a_flood_of_rejections_leaves_the_commands_in_the_log(flight):
    give(flight, "PING")
    for k in range(3 * CAPACITY):
        give(flight, "DELETE_FILE", {"path": "files/none"}, number=k)
    assert "PING" in [e["command"] for e in dumped(flight)]
    state = flight.config.resolve(flight.config.service.state_directory)
    assert len((state / "commands.jsonl").read_text().splitlines()) < 20


def test_security_events_have_a_store_of_their_own_that_survives_a_restart(arm):
    config = flight_config(arm)
    flight = Flight(config)
    flight.up()
    packet = telecommand_packet(DICTIONARY.telecommand("PING"), {}, 1)
    refused = Uplinked(packet=packet, error=Error.NOT_AUTHENTICATED, source="10.0.0.9:1")
    flight.app.receive(refused, flight.now)
    flight.app.context.report("TABLE_LOADED", "nothing of security")
    flight.app.close()
    again = Flight(config)
    again.up()
    for k in range(5000):
        again.app.context.report("TABLE_LOADED", str(k))
    entries = dumped(again, "SECURITY_LOG_DUMP", "event_log_entry")
    codes = {event.id: event.code for event in DICTIONARY.events}
    assert [codes[entry["event"]] for entry in entries] == ["TC_AUTH_FAILED"]
    assert entries[0]["boot_count"] == flight.app.context.boot.count
    again.app.close()


def test_an_empty_log_says_so(flight):
    assert dumped(flight, "SECURITY_LOG_DUMP", "event_log_entry")[0]["entries"] == 0


def test_the_file_is_bounded_and_the_one_before_is_read_too(tmp_path):
    journal = Journal(tmp_path / "log.jsonl", 10_000)
    for k in range(1000):
        journal.append({"number": k, "text": "x" * 40})
    sizes = [path.stat().st_size for path in tmp_path.iterdir()]
    assert len(sizes) == 2
    assert max(sizes) < 10_200
    numbers = [line["number"] for line in journal.read()]
    assert numbers == list(range(1000 - len(numbers), 1000))


def test_the_most_frequent_kind_makes_room():
    log: FairLog[int] = FairLog(10)
    for k in range(8):
        log.add("a", k)
    for k in range(8, 108):
        log.add("b", k)
    log.add("c", 108)
    kept = list(log)
    assert len(kept) == len(log) == 10
    assert kept == sorted(kept)
    assert kept[-1] == 108
    assert sum(k < 8 for k in kept) >= 4


MONITOR = {"id": 9, "value": "health.ticks", "low": 1.0, "repetitions": 1, "stale_s": 0.0}


@pytest.mark.parametrize(
    ("action", "command", "arguments"),
    [
        ("standby", "STOP_IDENTIFICATION", ""),
        ("reset_estimator", "RESET_ESTIMATOR", ""),
        ("abort_batch", "ABORT_BATCH", ""),
    ],
)
def test_the_action_of_a_monitor_is_logged_with_its_outcome(flight, action, command, arguments):
    monitor = MonitorConfig.model_validate(MONITOR | {"action": action})
    flight.app.monitoring.apply(MonitorsTable(monitors=(monitor,)))
    flight.wait(0.3)
    assert ("TC_ACCEPTED", f"{command} (monitor 9)") in [(e.code, e.text) for e in flight.events]
    flight.answer(Code.NO_JOB, "nothing runs")
    (event,) = [e for e in flight.events if e.code == "TC_FAILED"]
    assert event.text.startswith(command)
    assert event.text.endswith("(monitor 9)")
    entry = dumped(flight)[0]
    assert (entry["who"], entry["command"], entry["arguments"]) == ("monitor 9", command, arguments)
    assert (entry["outcome"], entry["error"]) == (CommandOutcome.FAILED, Error.NOT_STAGED)


def test_an_action_that_the_loop_does_not_read_is_logged_as_failed(flight):
    monitor = MonitorConfig.model_validate(MONITOR | {"action": "reset_estimator"})
    flight.app.monitoring.apply(MonitorsTable(monitors=(monitor,)))
    flight.ring_full = True
    flight.wait(0.3)
    entry = dumped(flight)[0]
    assert (entry["outcome"], entry["error"]) == (CommandOutcome.FAILED, Error.BUSY)


def test_what_enters_safe_is_logged(arm):
    flight = Flight(flight_config(arm))
    flight.up()
    set_values(flight, {1: 30.0})
    flight.wait(31.0)
    entry = next(e for e in dumped(flight) if e["command"] == "SET_MODE")
    assert (entry["who"], entry["arguments"]) == ("command-loss timer", "mode=SAFE")
    assert entry["outcome"] == CommandOutcome.COMPLETED
    flight.app.close()


def test_a_local_command_without_an_answer_is_logged_as_failed(flight):
    flight.app.local_command(Command(name=CommandName.RESET, id=7))
    state = flight.config.resolve(flight.config.service.state_directory)
    assert '"ACCEPTED"' in (state / "commands.jsonl").read_text()
    flight.wait(6.0)
    entry = dumped(flight)[0]
    assert (entry["outcome"], entry["error"]) == (CommandOutcome.FAILED, Error.TIMEOUT)


def test_a_line_that_was_cut_takes_nothing_of_the_next(tmp_path):
    journal = Journal(tmp_path / "events.jsonl", 1 << 20)
    journal.append({"code": "FIRST"})
    with (tmp_path / "events.jsonl").open("ab") as file:
        file.write(b'{"code": "CUT')
    journal.append({"code": "SECOND"})
    assert [line["code"] for line in journal.read()] == ["FIRST", "SECOND"]
