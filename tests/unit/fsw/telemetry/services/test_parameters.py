"""On-board parameters: all or none, kept, and only where they may be changed."""

import math
import struct

import pytest

from fsw.messages.commands import Code, CommandName
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import parameters_data, telecommand_packet
from fsw.telemetry.tables.effective import effective_config
from tests.support.application_cases import BEGUN, DONE, Flight

LOSS, COUNT, GATE, FORGET, SETTLE = 1, 2, 10, 12, 13


def set_values(flight: Flight, changes: dict[int, float]) -> list[str]:
    before = len(flight.packets)
    data = parameters_data(changes)
    telecommand = DICTIONARY.telecommand("SET_PARAMETERS")
    values = {"count": data[0], "parameter": int.from_bytes(data[1:3], "big"), "value": data[3:]}
    flight.app.executor.receive(telecommand_packet(telecommand, values, 77))
    return [p.packet.name for p in flight.packets[before:]]


def value(flight: Flight, number: int) -> float:
    name = next(item.name for item in DICTIONARY.parameters if item.id == number)
    flight.send("REPORT_PARAMETERS", {"count": 1, "parameter": number})
    return flight.last(f"parameter_{name}")[name]


def test_values_are_the_configurations_until_they_are_set(flight: Flight):
    assert value(flight, GATE) == flight.config.estimator.gate_probability
    assert value(flight, SETTLE) == 25
    assert value(flight, FORGET) == 0.0


def test_several_are_set_at_once_and_kept_over_a_restart(flight: Flight):
    told = set_values(flight, {LOSS: 100.0, COUNT: 3})
    assert told == [*BEGUN, "event_info", DONE[2]]
    again = Flight(flight.config)
    again.up()
    assert (value(again, LOSS), value(again, COUNT)) == (100.0, 3)


@pytest.mark.parametrize("bad", [{LOSS: -1.0}, {LOSS: 1e9}, {LOSS: math.inf}, {COUNT: 0}])
def test_one_out_of_range_leaves_all_as_they_were(flight: Flight, bad):
    assert "acceptance_failure" in set_values(flight, {3: 5.0} | bad)
    assert flight.error() is Error.OUT_OF_RANGE
    assert value(flight, 3) == 10.0
    assert Flight(flight.config).app.context.parameter("event_throttle_period_s") == 10.0


def test_settings_of_the_estimator_need_a_daemon_at_rest(flight: Flight):
    assert "acceptance_failure" in set_values(flight, {COUNT: 5, SETTLE: 30})
    assert flight.error() is Error.WRONG_MODE
    assert value(flight, COUNT) == 10


def test_settings_of_the_estimator_are_set_when_the_loop_has_them(flight: Flight):
    flight.up(identifying=False)
    assert set_values(flight, {SETTLE: 30, FORGET: 600.0, COUNT: 5}) == BEGUN
    assert value(flight, COUNT) == 10
    command = flight.commands[0]
    assert command.name is CommandName.CONFIGURE
    assert command.args == {"estimator": {"forgetting_time_s": 600.0, "settle_blocks": 30}}
    flight.answer()
    assert (value(flight, SETTLE), value(flight, COUNT)) == (30, 5)
    started = effective_config(flight.config).estimator
    assert (started.settle_blocks, started.forgetting_time_s) == (30, 600.0)


def test_what_the_loop_refuses_is_not_set(flight: Flight):
    flight.up(identifying=False)
    set_values(flight, {SETTLE: 30, COUNT: 5})
    flight.answer(Code.BAD_ARGUMENT, "no")
    assert value(flight, COUNT) == 10
    assert effective_config(flight.config).estimator.settle_blocks == 25


def test_damaged_parameters_are_told_and_the_ones_before_are_used(flight: Flight):
    set_values(flight, {COUNT: 5})
    set_values(flight, {COUNT: 7})
    folder = flight.config.resolve(flight.config.service.state_directory) / "parameters"
    newest = max(folder.glob("*.gen"))
    newest.write_bytes(b"\0" + newest.read_bytes()[1:])
    again = Flight(flight.config)
    again.up()
    assert value(again, COUNT) == 5
    assert "PARAMETERS_CORRUPT" in again.codes


def test_what_is_no_number_is_refused(flight: Flight):
    telecommand = DICTIONARY.telecommand("SET_PARAMETERS")
    values = {"count": 1, "parameter": LOSS, "value": struct.pack(">f", math.nan)}
    flight.app.executor.receive(telecommand_packet(telecommand, values, 78))
    assert flight.error() is Error.OUT_OF_RANGE
