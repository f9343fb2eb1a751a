"""Tables: load, validate, activate, dump, abort, roll back; what does not fit changes nothing."""

import re
import zlib
from pathlib import Path

import numpy as np
import pytest
import yaml

import fsw.telemetry
from fsw.checks import rehearsal
from fsw.config.telemetry import STATE_FOLDERS
from fsw.messages.commands import Code, CommandName
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.tables.effective import BOOT, PARAMETERS, TABLES, effective_config
from tests.conftest import ArmProject, arm_urdf
from tests.support.application_cases import BEGUN, DONE, Flight, flight_config

RATES = b"sets: {8: {interval_s: 0.5}, 1: {interval_s: 2.0, enabled: false}}"
NOISE = b"joints: {axis2: {torque_noise_nm: 0.25}}"
HEAVY = arm_urdf(3).replace('mass value="3"', 'mass value="5"').encode()


def load(flight: Flight, table: str, content: bytes, piece: int = 100) -> None:
    """Send a table in pieces."""
    values = {"table": table, "size_bytes": len(content), "crc32": zlib.crc32(content)}
    assert flight.send("TBL_LOAD", values) == DONE
    for offset in range(0, len(content), piece):
        data = content[offset : offset + piece]
        flight.send("TBL_DATA", {"table": table, "offset": offset, "data": data})
    assert flight.packets[-1].packet.name == "completion_success"


def activate(flight: Flight, table: str, content: bytes) -> list[str]:
    load(flight, table, content)
    assert "completion_success" in flight.send("TBL_VALIDATE", {"table": table})
    return flight.send("TBL_ACTIVATE", {"table": table, "crc32": zlib.crc32(content)})


@pytest.fixture
def quiet(flight: Flight) -> Flight:
    """A daemon at rest, in which tables may be activated."""
    flight.up(identifying=False)
    return flight


def states(flight: Flight, table: str) -> tuple[int, int, int]:
    told = flight.app.tables.values()
    return tuple(told[f"{table}_{key}"] for key in ("state", "generation", "staged_bytes"))


def test_rates_hold_from_their_activation_on_and_over_a_restart(quiet: Flight):
    assert activate(quiet, "RATES", RATES) == [*BEGUN, "event_info", "completion_success"]
    assert states(quiet, "rates") == (0, 1, 0)
    quiet.wait(2.0)
    assert len(quiet.all("link")) == 4
    again = Flight(quiet.config)
    again.wait(2.0)
    assert len(again.all("link")) == 4
    assert again.app.context.boot.count == 2


def test_noise_and_robot_reach_the_loop_at_a_tick_and_the_configuration_in_force(quiet: Flight):
    assert activate(quiet, "NOISE", NOISE) == BEGUN
    command = quiet.commands[0]
    assert command.name is CommandName.CONFIGURE
    assert command.args["noise"]["joints"]["axis2"]["torque_noise_nm"] == 0.25
    assert command.args["noise"]["joints"]["axis1"]["torque_noise_nm"] == 0.05
    assert states(quiet, "noise")[0] == 4
    quiet.answer()
    assert states(quiet, "noise")[:2] == (0, 1)
    assert quiet.in_force[-1].joints[1].torque_noise_nm == 0.25
    assert activate(quiet, "ROBOT", HEAVY) == BEGUN
    assert quiet.commands[0].args["urdf_text"].encode() == HEAVY
    assert quiet.commands[0].args["noise"]["joints"]["axis2"]["torque_noise_nm"] == 0.25
    quiet.answer()
    config = quiet.in_force[-1]
    assert config.resolve(config.robot.urdf).read_bytes() == HEAVY
    started = effective_config(quiet.config)
    assert started.joints[1].torque_noise_nm == 0.25
    assert started.resolve(started.robot.urdf).read_bytes() == HEAVY


def test_what_the_loop_refuses_is_not_kept(quiet: Flight):
    activate(quiet, "NOISE", NOISE)
    quiet.answer(Code.BAD_ARGUMENT, "no")
    assert quiet.error() is Error.BAD_ARG
    assert states(quiet, "noise")[:2] == (3, 0)
    assert effective_config(quiet.config).joints[1].torque_noise_nm == 0.05
    assert quiet.in_force == []


def test_one_table_is_activated_at_a_time_each_with_what_is_in_force_of_the_others(quiet: Flight):
    load(quiet, "ROBOT", HEAVY)
    quiet.send("TBL_VALIDATE", {"table": "ROBOT"})
    robot = {"table": "ROBOT", "crc32": zlib.crc32(HEAVY)}
    assert activate(quiet, "NOISE", NOISE) == BEGUN
    assert quiet.refused("TBL_ACTIVATE", robot) is Error.BUSY
    quiet.answer()
    assert quiet.send("TBL_ACTIVATE", robot) == BEGUN
    assert quiet.commands[0].args["noise"]["joints"]["axis2"]["torque_noise_nm"] == 0.25


def test_a_robot_the_loop_refuses_does_not_take_the_place_of_the_one_in_force(quiet: Flight):
    activate(quiet, "ROBOT", HEAVY)
    quiet.answer()
    in_force = quiet.in_force[-1]
    activate(quiet, "ROBOT", arm_urdf(3).replace('mass value="3"', 'mass value="9"').encode())
    quiet.answer(Code.BAD_ARGUMENT, "no")
    assert in_force.resolve(in_force.robot.urdf).read_bytes() == HEAVY
    started = effective_config(quiet.config)
    assert started.resolve(started.robot.urdf).read_bytes() == HEAVY
    folder = quiet.config.resolve(quiet.config.service.state_directory) / "tables"
    assert len(list(folder.glob("*.urdf"))) == 1


def test_a_silent_loop_times_out_and_the_old_table_stays(quiet: Flight):
    activate(quiet, "NOISE", NOISE)
    assert quiet.send("TBL_ABORT", {"table": "NOISE"})[0] == "acceptance_failure"
    assert quiet.error() is Error.BUSY
    quiet.wait(6.0)
    assert quiet.error() is Error.TIMEOUT
    assert states(quiet, "noise")[:2] == (3, 0)


@pytest.mark.parametrize(
    ("table", "content"),
    [
        ("NOISE", b"joints: {elbow: {torque_noise_nm: 1.0}}"),
        ("NOISE", b"joints: {axis1: {torque_noise_nm: -1.0}}"),
        ("NOISE", b"joints: ["),
        ("NOISE", b"\xff\xfe"),
        ("NOISE", b"when: 2026-13-45"),
        ("RATES", b"sets: {9: {interval_s: 1.0}}"),
        ("RATES", b"sets: {1: {interval_s: .nan}}"),
        ("MONITORS", b"monitors: [{id: 1, value: health.nothing, low: 1.0}]"),
        ("MONITORS", b"monitors: [{id: 1, value: health.slips}]"),
        ("ROBOT", b"<robot/>"),
        ("ROBOT", b"no xml"),
        ("ROBOT", arm_urdf(4).encode()),
        ("ROBOT", arm_urdf(3).replace('mass value="3"', 'mass value="-3"').encode()),
    ],
)
def test_a_table_that_does_not_validate_changes_nothing(quiet: Flight, table, content):
    before = effective_config(quiet.config)
    load(quiet, table, content)
    assert "completion_failure" in quiet.send("TBL_VALIDATE", {"table": table})
    assert quiet.error() is Error.NOT_VALIDATED
    assert "TABLE_INVALID" in quiet.codes
    told = quiet.refused("TBL_ACTIVATE", {"table": table, "crc32": zlib.crc32(content)})
    assert told is Error.NOT_VALIDATED
    assert effective_config(quiet.config) == before
    assert quiet.commands == []


def test_rates_that_the_loop_cannot_hand_over_do_not_validate(arm: ArmProject):
    flight = Flight(flight_config(arm, science_rate_hz=50.0))
    flight.up(identifying=False)
    load(flight, "RATES", b"sets: {20: {interval_s: 0.019}}")
    assert "completion_failure" in flight.send("TBL_VALIDATE", {"table": "RATES"})
    assert flight.error() is Error.NOT_VALIDATED
    load(flight, "RATES", b"sets: {20: {interval_s: 0.02}}")
    assert flight.send("TBL_VALIDATE", {"table": "RATES"})[-1] == "completion_success"


def test_steps_out_of_turn_are_refused(quiet: Flight):
    table = {"table": "RATES"}
    assert quiet.refused("TBL_VALIDATE", table) is Error.NOT_STAGED
    assert quiet.refused("TBL_ABORT", table) is Error.NOT_STAGED
    assert quiet.refused("TBL_ROLLBACK", table) is Error.NOT_STAGED
    assert quiet.refused("TBL_ACTIVATE", table | {"crc32": 0}) is Error.NOT_STAGED
    assert quiet.refused("TBL_DUMP", table | {"copy": "STAGED"}) is Error.NOT_STAGED
    data = table | {"offset": 0, "data": b"x"}
    assert quiet.refused("TBL_DATA", data) is Error.NOT_STAGED
    load(quiet, "RATES", RATES)
    wrong = table | {"crc32": 1}
    quiet.send("TBL_VALIDATE", table)
    assert quiet.refused("TBL_ACTIVATE", wrong) is Error.CRC_MISMATCH


def test_pieces_may_come_twice_but_not_beyond(quiet: Flight):
    quiet.send("TBL_LOAD", {"table": "RATES", "size_bytes": 10, "crc32": zlib.crc32(b"abcdefghij")})
    quiet.send("TBL_DATA", {"table": "RATES", "offset": 0, "data": b"abxx"})
    quiet.send("TBL_DATA", {"table": "RATES", "offset": 2, "data": b"cdef"})
    gap = {"table": "RATES", "offset": 7, "data": b"h"}
    assert quiet.refused("TBL_DATA", gap) is Error.OUT_OF_RANGE
    beyond = {"table": "RATES", "offset": 6, "data": b"ghijk"}
    assert quiet.refused("TBL_DATA", beyond) is Error.OUT_OF_RANGE
    quiet.send("TBL_DATA", {"table": "RATES", "offset": 6, "data": b"ghij"})
    assert states(quiet, "rates") == (2, 0, 10)


def test_a_load_that_came_damaged_is_dropped(quiet: Flight):
    quiet.send("TBL_LOAD", {"table": "RATES", "size_bytes": 3, "crc32": 1})
    quiet.send("TBL_DATA", {"table": "RATES", "offset": 0, "data": b"abc"})
    assert quiet.error() is Error.CRC_MISMATCH
    assert states(quiet, "rates") == (0, 0, 0)


def test_a_table_comes_from_a_file_that_came_up(quiet: Flight):
    folder = quiet.config.resolve(quiet.config.service.state_directory) / "files"
    (folder / "rates.yaml").write_bytes(RATES)
    values = {"table": "RATES", "crc32": zlib.crc32(RATES), "path": "files/rates.yaml"}
    assert "completion_success" in quiet.send("TBL_LOAD_FILE", values)
    assert states(quiet, "rates") == (2, 0, len(RATES))
    missing = values | {"path": "files/none"}
    assert quiet.refused("TBL_LOAD_FILE", missing) is Error.FILE_NOT_FOUND
    quiet.send("TBL_LOAD_FILE", values | {"crc32": 5})
    assert quiet.error() is Error.CRC_MISMATCH


def test_a_rollback_brings_the_one_before_and_then_the_configuration_back(quiet: Flight):
    activate(quiet, "RATES", RATES)
    other = b"sets: {8: {interval_s: 0.2}}"
    activate(quiet, "RATES", other)
    assert quiet.app.housekeeping.rates()[8]["interval_s"] == 0.2
    quiet.send("TBL_ROLLBACK", {"table": "RATES"})
    assert quiet.app.housekeeping.rates()[8]["interval_s"] == 0.5
    assert quiet.app.tables.values()["rates_generation"] == 3
    fresh = Flight(quiet.config)
    assert fresh.app.housekeeping.rates()[8]["interval_s"] == 0.5


def test_the_first_activation_rolls_back_to_the_configuration(quiet: Flight):
    activate(quiet, "NOISE", NOISE)
    quiet.answer()
    quiet.send("TBL_ROLLBACK", {"table": "NOISE"})
    assert quiet.commands[0].args["noise"]["joints"]["axis2"]["torque_noise_nm"] == 0.05
    quiet.answer()
    assert quiet.in_force[-1].joints[1].torque_noise_nm == 0.05
    assert effective_config(quiet.config).joints[1].torque_noise_nm == 0.05


def test_activation_needs_a_daemon_at_rest(flight: Flight):
    load(flight, "RATES", RATES)
    flight.send("TBL_VALIDATE", {"table": "RATES"})
    told = flight.refused("TBL_ACTIVATE", {"table": "RATES", "crc32": zlib.crc32(RATES)})
    assert told is Error.WRONG_MODE


def test_a_dump_is_what_is_in_force_and_can_be_loaded_again(quiet: Flight):
    for table in ("NOISE", "RATES", "MONITORS", "ROBOT"):
        quiet.send("TBL_DUMP", {"table": table, "copy": "ACTIVE"})
        told = quiet.last("table_dumped")
        path = quiet.app.filing.find(told["path"])
        assert zlib.crc32(path.read_bytes()) == told["crc32"]
        load(quiet, table, path.read_bytes())
        assert "completion_success" in quiet.send("TBL_VALIDATE", {"table": table})
    noise = yaml.safe_load((path.parent / "noise_active.yaml").read_text())
    assert noise["joints"]["axis3"]["position_noise_rad"] == 1e-5


def test_a_damaged_generation_gives_way_to_the_one_before_and_is_told(quiet: Flight):
    activate(quiet, "RATES", RATES)
    activate(quiet, "RATES", b"sets: {8: {interval_s: 0.2}}")
    folder = quiet.config.resolve(quiet.config.service.state_directory) / "tables" / "rates"
    newest = max(folder.glob("*.gen"))
    newest.write_bytes(newest.read_bytes()[:-3])
    again = Flight(quiet.config)
    assert again.app.housekeeping.rates()[8]["interval_s"] == 0.5
    assert "TABLE_CORRUPT" in again.codes
    assert again.app.supervision.health.latched


def test_the_staged_table_can_be_dropped(quiet: Flight):
    load(quiet, "RATES", RATES)
    assert "completion_success" in quiet.send("TBL_ABORT", {"table": "RATES"})
    assert states(quiet, "rates") == (0, 0, 0)


def test_a_configuration_that_is_not_what_the_table_was_made_for_leaves_it_out(arm: ArmProject):
    flight = Flight(flight_config(arm))
    flight.up(identifying=False)
    activate(flight, "ROBOT", HEAVY)
    flight.answer()
    other = ArmProject(arm.folder, 4)
    config = flight_config(other)
    assert effective_config(config).robot == config.robot


BODY = "inertia_kg_m2: [6.0, 0.0, 0.0, 5.0, 0.0, 4.0]"
SIGMA = "sigma: {mass_kg: 40.0, com_m: [0.2, 0.2, 0.2], inertia_kg_m2: [3, 1, 1, 3, 1, 3]}"
LINKS = "".join(f'<link name="more{k}"/>' for k in range(5000))
HOSTILE = {
    "mass": ("NOISE", f"bodies: {{target: {{mass_kg: 1e-6, com_m: [0, 0, 0], {BODY}, {SIGMA}}}}}"),
    "com": ("NOISE", f"bodies: {{target: {{mass_kg: 80, com_m: [7e4, 0, 0], {BODY}, {SIGMA}}}}}"),
    "sigma": (
        "NOISE",
        f"bodies: {{target: {{mass_kg: 80, com_m: [0, 0, 0], {BODY}, "
        f"{SIGMA.replace('40.0', '1e10')}}}}}",
    ),
    "noise": ("NOISE", "joints: {axis1: {torque_noise_nm: 1.0e+155}}"),
    "wrench": ("NOISE", "estimator: {wrench_force_sigma_n: 1.0e+200}"),
    "aliases": ("NOISE", "joints: &a {axis1: *a}"),
    "depth": ("MONITORS", "[" * 5000),
    "number": ("RATES", "sets: {1: {interval_s: " + "9" * 5000 + "}}"),
    "key": ("RATES", "sets: {0x" + "f" * 5000 + ": {interval_s: 1.0}}"),
    "origin": ("ROBOT", arm_urdf(3).replace('xyz="0 0 0.4"', 'xyz="0 0 1e300"')),
    "mass of a link": ("ROBOT", arm_urdf(3).replace('mass value="3"', 'mass value="1e300"')),
    "links": ("ROBOT", arm_urdf(3).replace("</robot>", LINKS + "</robot>")),
    "chain": ("ROBOT", arm_urdf(1500)),
    "document type": ("ROBOT", '<!DOCTYPE robot [<!ENTITY a "b">]>' + arm_urdf(3)),
    "encoding": (
        "ROBOT",
        '<?xml version="1.0" encoding="latin-1"?>' + arm_urdf(3).replace('"arm"', '"\xe9"'),
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_table_that_no_robot_can_have_is_refused_in_short_words(quiet: Flight, name: str):
    table, text = HOSTILE[name]
    load(quiet, table, text.encode("latin-1"), piece=900)
    assert "completion_failure" in quiet.send("TBL_VALIDATE", {"table": table})
    assert quiet.error() is Error.NOT_VALIDATED
    (event,) = [event for event in quiet.events if event.code == "TABLE_INVALID"]
    assert len(event.text) <= 1000
    assert quiet.commands == []


def test_a_table_whose_dry_update_fails_is_refused(quiet: Flight, monkeypatch):
    def singular(*_arguments: object) -> None:
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr("fsw.checks.rehearsal.build_online", singular)
    load(quiet, "NOISE", NOISE)
    assert "completion_failure" in quiet.send("TBL_VALIDATE", {"table": "NOISE"})
    assert "a dry update fails: LinAlgError: singular" in quiet.events[-2].text


def test_a_table_that_breaks_validation_itself_is_not_valid_at_a_start_either(
    quiet: Flight, monkeypatch
):
    assert activate(quiet, "NOISE", NOISE) == BEGUN
    quiet.answer()

    def broken(*_arguments: object) -> None:
        raise RuntimeError("nobody foresaw this")

    monkeypatch.setattr("fsw.checks.configuration.load_problem", broken)
    again = Flight(quiet.config)
    assert "TABLE_CORRUPT" in again.codes
    assert effective_config(quiet.config).joints[1].torque_noise_nm == 0.05


def test_no_folder_the_daemon_keeps_its_state_in_may_be_the_file_directory():
    sources = (Path(fsw.telemetry.__file__).parent / "services").glob("*.py")
    found = {TABLES, PARAMETERS, BOOT}
    for source in sources:
        line = re.search(r"^FOLDER\b.*", source.read_text(), re.MULTILINE)
        found |= set(re.findall(r'"(\w+)"', line[0])) if line else set()
    assert found == set(STATE_FOLDERS)


def test_an_activation_does_not_repeat_the_dry_update_of_its_validation(quiet: Flight, monkeypatch):
    tried: list[object] = []
    real = rehearsal.build_online
    monkeypatch.setattr(
        rehearsal, "build_online", lambda *given: tried.append(given) or real(*given)
    )
    assert activate(quiet, "NOISE", NOISE) == BEGUN
    quiet.answer()
    assert len(tried) == 1
    assert activate(quiet, "NOISE", NOISE.replace(b"0.25", b"0.35")) == BEGUN
    assert len(tried) == 2
    quiet.answer()
    assert activate(quiet, "ROBOT", HEAVY) == BEGUN
    assert len(tried) == 4, "the noise in force is tried above another robot"
