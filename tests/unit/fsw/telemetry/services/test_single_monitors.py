"""Service 12: monitors added, modified, deleted and switched one by one, over a restart."""

import pytest

from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.dictionary.onboard_commands import LARGEST
from fsw.telemetry.dictionary.parameters import VALUE
from tests.support.application_cases import DONE, Flight

SLIPS = VALUE.value("health.slips")


def definition(monitor: int = 7, **changes: object) -> dict:
    values = {"monitor": monitor, "value": SLIPS, "repetitions": 1, "low": -LARGEST}
    return values | {"high": 10.0, "stale_s": 0.0, "action": "NONE"} | changes


def add(flight: Flight, monitor: int = 7, **changes: object) -> None:
    assert flight.send("ADD_MONITOR", definition(monitor, **changes)) == DONE


def told(flight: Flight, monitor: int = 7) -> dict:
    flight.send("REPORT_MONITOR", {"monitor": monitor})
    return flight.last("monitor_definition")


def test_an_added_monitor_is_disabled_checks_once_enabled_and_acts(flight: Flight):
    add(flight, action="SAFE")
    flight.up(slips=11)
    flight.wait(1.0)
    assert flight.all("check_transition") == []
    assert flight.send("ENABLE_MONITOR", {"monitor": 7}) == DONE
    flight.wait(1.0)
    assert flight.last("check_transition")["limit"] == 10.0
    assert "LIMIT_ACTION" in flight.codes


def test_all_of_it_survives_a_restart_and_a_rollback_undoes_the_last_change(flight: Flight):
    add(flight)
    add(flight, 8, low=1.0, high=LARGEST)
    flight.send("ENABLE_MONITOR", {"monitor": 8})
    again = Flight(flight.config)
    again.up(identifying=False)
    assert (told(again, 7)["enabled"], told(again, 8)["enabled"]) == (0, 1)
    assert (told(again, 8)["low"], told(again, 8)["high"]) == (1.0, LARGEST)
    assert again.send("TBL_ROLLBACK", {"table": "MONITORS"})[-1] == DONE[-1]
    assert told(again, 8)["enabled"] == 0


def test_a_modified_one_keeps_its_switch_and_the_others_their_status(flight: Flight):
    for number in (7, 8):
        add(flight, number)
        flight.send("ENABLE_MONITOR", {"monitor": number})
    flight.up(slips=11)
    flight.wait(1.0)
    assert len(flight.all("check_transition")) == 2
    assert flight.send("MODIFY_MONITOR", definition(7, high=20.0)) == DONE
    flight.wait(1.0)
    assert len(flight.all("check_transition")) == 2  # 8 is not reported again
    assert (told(flight)["enabled"], told(flight)["high"]) == (1, 20.0)


def test_deleted_only_when_disabled(flight: Flight):
    add(flight)
    flight.send("ENABLE_MONITOR", {"monitor": 7})
    assert flight.refused("DELETE_MONITOR", {"monitor": 7}) is Error.BUSY
    flight.send("DISABLE_MONITOR", {"monitor": 7})
    assert flight.send("DELETE_MONITOR", {"monitor": 7}) == DONE
    assert flight.refused("REPORT_MONITOR", {"monitor": 7}) is Error.BAD_ARG


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"low": 2.0, "high": 1.0}, Error.BAD_ARG),
        ({"high": LARGEST}, Error.BAD_ARG),  # nothing to check
        ({"value": 1}, Error.BAD_ARG),
        ({"repetitions": 0}, Error.OUT_OF_RANGE),
        ({"stale_s": -1.0}, Error.OUT_OF_RANGE),
        ({"action": 9}, Error.BAD_ARG),
        ({"monitor": 0}, Error.OUT_OF_RANGE),
    ],
)
def test_what_is_no_monitor_is_refused(flight: Flight, changes: dict, error: Error):
    assert flight.refused("ADD_MONITOR", definition() | changes) is error
    assert flight.app.monitoring.table() == []


def test_a_number_in_use_an_unknown_one_and_a_full_table_are_refused(flight: Flight):
    assert flight.refused("MODIFY_MONITOR", definition()) is Error.BAD_ARG
    assert flight.refused("DELETE_MONITOR", {"monitor": 7}) is Error.BAD_ARG
    for number in range(1, 65):
        add(flight, number)
    assert flight.refused("ADD_MONITOR", definition(1)) is Error.BAD_ARG
    assert flight.refused("ADD_MONITOR", definition(65)) is Error.BUSY
