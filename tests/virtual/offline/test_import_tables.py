"""`fsw import` of tables in the forms that other tools write, of angles that wrap, and of rails."""

import json
from collections.abc import Callable
from datetime import UTC, datetime
from itertools import pairwise
from math import pi, tau

import numpy as np
import pytest
import yaml

from fsw.__main__ import main
from fsw.exchange.recording import messages
from tests.support.import_cases import SAMPLES_HZ, Import, importing  # noqa: F401

ROWS = 300
T = np.arange(ROWS) / SAMPLES_HZ
NAMES = ["t", "q_j1", "q_j2", "tau_j1", "tau_j2"]
VALUES = np.column_stack(
    [T, 0.5 * np.sin(T), 0.1 * np.cos(T), 3 * np.sin(3 * T), 5 + np.cos(2 * T)]
)
MAPPING = {
    "joints": {
        "time": {"column": "t", "unit": "s"},
        "position": {"columns": "q_{}", "unit": "rad"},
        "torque": {"columns": "tau_{}", "unit": "N m"},
    }
}
BY_NUMBER = {
    "joints": {
        "time": {"column": 1, "unit": "s"},
        "position": {"columns": [2, 3], "unit": "rad"},
        "torque": {"columns": [4, 5], "unit": "N m"},
    }
}


@pytest.fixture
def arm(importing: Callable[..., Import]) -> Import:  # noqa: F811
    return importing(sampled=True)


def lines(values: np.ndarray = VALUES, names: list[str] | None = None, by: str = ",") -> list[str]:
    """Return a header and rows with all digits."""
    rows = [by.join(map(repr, row)) for row in values.tolist()]
    return [by.join(names if names is not None else NAMES), *rows]


def positions(arm: Import, key: str = "position_rad") -> list[dict[str, float]]:
    return [json.loads(item.data)[key] for item in messages(arm.out, ["/samples/joints"])]


def imported(arm: Import, text: list[str] | str, mapping: object = MAPPING, end: str = "\n") -> int:
    path = arm.folder / "a.csv"
    path.write_text(text if isinstance(text, str) else "\n".join(text) + end, encoding="utf-8")
    return arm.table(path, mapping)


def test_a_plain_table_is_read_and_nothing_is_counted(arm):
    assert imported(arm, lines()) == 0
    assert [row["j1"] for row in positions(arm)] == VALUES[:, 1].tolist()
    for word in ("left out", "comment", "decimal", "wraps", "jumps", "rejected"):
        assert word not in arm.said


FORMS = {
    "quoted header": lambda: [",".join(f'"{name}"' for name in NAMES), *lines()[1:]],
    "quoted cells": lambda: [",".join(f'"{cell}"' for cell in line.split(",")) for line in lines()],
    "semicolons": lambda: lines(by=";"),
    "tabs": lambda: lines(by="\t"),
    "spaces": lambda: lines(by="  "),
    "spaces around": lambda: lines(by=" , "),
    "decimal commas": lambda: [line.replace(".", ",") for line in lines(by=";")],
    "quoted decimal commas": lambda: [
        ",".join(f'"{cell.replace(".", ",")}"' for cell in line.split(",")) for line in lines()
    ],
    "comments": lambda: ["# made by a tool", "% 5 columns", "// 2026", *lines()],
    "a comment as header": lambda: ["# of a tool", "# " + lines()[0], *lines()[1:]],
    "comments in between": lambda: [*lines()[:40], "# paused", *lines()[40:]],
    "blank lines": lambda: [*lines()[:40], "", *lines()[40:], ""],
    "a delimiter at the end": lambda: [lines()[0], *(f"{line}," for line in lines()[1:])],
    "line ends of Windows": lambda: [f"{line}\r" for line in lines()],
    "the separator of Excel, comments of it": lambda: ["sep=;", *lines(by=";")],
    "bars": lambda: lines(by="|"),
    "a title": lambda: ["Recording of the arm, 2026-11-28", *lines()],
    "titles of two cells": lambda: ["Robot;arm", "Start;2026-11-28", *lines(by=";")],
    "a row of units": lambda: [lines()[0], "s,rad,rad,N m,N m", *lines()[1:]],
    "a title of as many cells": lambda: ["Arm,run 12,Ada,lab 2b,wet", *lines()],
    "a title of as many cells, and units": lambda: [
        "Arm,run 12,Ada,lab 2b,wet",
        lines()[0],
        "[s],[rad],[rad],[Nm],[Nm]",
        *lines()[1:],
    ],
    "titles and units": lambda: ["Export", *lines()[:1], "[s],[rad],,[Nm],[Nm]", *lines()[1:]],
    "units, and last cells that are mostly empty": lambda: [
        f"{lines()[0]},qx,qy",
        "s,rad,rad,N m,N m,,",
        *(f"{line}{',,' if row % 10 else ',0,1'}" for row, line in enumerate(lines()[1:])),
    ],
    "byte order mark": lambda: ["\ufeff" + lines()[0], *lines()[1:]],
}


COMMENTED = [form for form in FORMS if "comment" in form]


@pytest.mark.parametrize("form", FORMS)
def test_a_form_of_other_tools_is_read_alike(arm, form):
    assert imported(arm, FORMS[form]()) == 0
    assert [row["j2"] for row in positions(arm)] == VALUES[:, 2].tolist()
    assert len(positions(arm)) == ROWS
    assert ("comment lines: " in arm.said) == (form in COMMENTED)
    assert ("decimal comma" in arm.said) == ("decimal" in form)
    assert ("lines above the header, left out: " in arm.said) == ("title" in form)
    assert ("row of units, left out: " in arm.said) == ("units" in form)


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-8-sig"])
def test_a_header_with_degree_signs_in_any_encoding_is_read(arm, encoding):
    names = ["t", "Winkel 1 [°]", "Winkel 2 [°]", "tau_j1", "tau_j2"]
    mapping = json.loads(json.dumps(MAPPING))
    mapping["joints"]["position"] = {"columns": names[1:3], "unit": "deg"}
    path = arm.folder / "a.csv"
    path.write_text("\n".join(lines(names=names)) + "\n", encoding=encoding)
    assert arm.table(path, mapping) == 0
    assert np.allclose([row["j2"] for row in positions(arm)], np.radians(VALUES[:, 2]))


@pytest.mark.parametrize("by", [",", " ", ";"])
def test_columns_without_a_header_are_mapped_by_number(arm, by):
    assert imported(arm, lines(by=by)[1:], BY_NUMBER) == 0
    assert [row["j2"] for row in positions(arm)] == VALUES[:, 2].tolist()
    assert len(positions(arm)) == ROWS


@pytest.mark.parametrize("names", [["0", "1", "2", "3", "4"], ["t", "a", "b", "a", "b"]])
def test_columns_below_a_useless_header_are_mapped_by_number(arm, names):
    """Pandas numbers columns without names from 0: these are names, and 1 is no first column."""
    mapping = BY_NUMBER
    if names[0] == "0":
        text = json.dumps(BY_NUMBER)
        for k in range(1, 6):
            text = text.replace(f": {k},", f": {k - 1},").replace(f"[{k},", f"[{k - 1},")
            text = text.replace(f", {k}]", f", {k - 1}]")
        mapping = json.loads(text)
    assert imported(arm, lines(names=names), mapping) == 0
    assert [row["j2"] for row in positions(arm)] == VALUES[:, 2].tolist()
    assert len(positions(arm)) == ROWS


def test_a_name_that_two_columns_have_is_refused(arm):
    assert imported(arm, lines(names=["t", "q_j1", "q_j2", "tau_j1", "tau_j1"])) == 2
    assert arm.is_refused("2 columns 'tau_j1'", "numbers")


@pytest.mark.parametrize("number", [0, 6])
def test_a_column_number_out_of_range_says_where_counting_begins(arm, number):
    mapping = json.loads(json.dumps(BY_NUMBER))
    mapping["joints"]["torque"]["columns"] = [4, number]
    assert imported(arm, lines()[1:], mapping) == 2
    assert arm.is_refused(f"no column '{number}'", "counted from 1 to 5")


def test_a_misspelt_torque_is_never_replaced_by_a_position(arm):
    assert imported(arm, lines(names=["t", "q_j1", "q_j2", "u1", "u2"])) == 2
    assert arm.is_refused("no column 'tau_j1'")
    assert "did you mean" not in arm.refused[0]


def test_a_cut_last_line_is_left_out_with_a_count(arm):
    assert imported(arm, "\n".join(lines())[:-4]) == 0
    assert "last line, which is cut off, left out: 1" in arm.said
    assert len(positions(arm)) == ROWS - 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda row: ["7", *(cell.replace(".", ",") for cell in row[1:])], "decimal commas need"),
        (lambda row: [*row[:4], f"{row[4]} Nm"], "must be a number, without a unit"),
        (lambda row: [*row[:4], '"1,005.5"'], "must be a number, without a thousands separator"),
        (lambda row: ["12:00:00.5", *row[1:]], "'t' is '12:00:00.5'; must be a number"),
    ],
)
def test_what_a_table_program_adds_to_a_number_is_named(arm, change, words):
    assert imported(arm, [lines()[0], *(",".join(change(x.split(","))) for x in lines()[1:])]) == 2
    assert arm.is_refused(words)


def test_few_rows_of_another_length_are_left_out_and_counted(arm):
    text = lines()
    text[50] = text[50].rpartition(",")[0]
    text[90] += ",7"
    assert imported(arm, text) == 0
    assert "rows of another length, left out: 2, the first is line 51" in arm.said
    assert len(positions(arm)) == ROWS - 2


def test_many_rows_of_another_length_are_refused(arm):
    text = lines()
    text[50:100] = [line.rpartition(",")[0] for line in text[50:100]]
    assert imported(arm, text) == 2
    assert arm.is_refused("line 51 has 4 values for 5 columns")


@pytest.mark.parametrize(
    ("units", "words"),
    [
        (
            "s,deg,deg,N m,N m",
            "joints.position: the row of units says 'deg' of 'q_j1'; the mapping",
        ),
        ("ms,rad,rad,N m,N m", "joints.time: the row of units says 'ms' of 't'; the mapping"),
        ("[s],[rad],[rad],[Nm],[mNm]", "joints.torque: the row of units says '[mNm]' of 'tau_j2'"),
    ],
)
def test_units_that_contradict_the_mapping_are_refused(arm, units, words):
    assert imported(arm, [lines()[0], units, *lines()[1:]]) == 2
    assert arm.is_refused(words)


def test_words_in_the_first_rows_of_a_column_are_no_units(arm):
    text = [lines()[0] + ",mode", *(line + ",run" for line in lines()[1:])]
    text[10:] = [line.removesuffix("run") for line in text[10:]]
    assert imported(arm, text) == 0
    assert len(positions(arm)) == ROWS


def test_decimal_commas_between_commas_are_refused_with_the_cure(arm):
    text = [",".join("0,5" for _ in NAMES) for _ in range(ROWS)]
    assert imported(arm, [lines()[0], *text]) == 2
    assert arm.is_refused("decimal commas need another separator")


@pytest.mark.parametrize("cell", ["", "nan", "NaN", "null", "None", "N/A", "#N/A", "1.#QNAN"])
def test_words_for_nothing_are_no_numbers_and_are_counted(arm, cell):
    text = lines()
    text[50] = text[50].rpartition(",")[0] + f",{cell}"
    assert imported(arm, text) == 0
    assert "rejected of tau_j2: 1 not a number" in arm.said


def test_decimal_commas_beside_points_in_one_column_are_refused(arm):
    text = lines(by=";")
    text[60] = text[60].replace(";0.1", ";0,1", 1).replace(";0.0", ";0,0", 1)
    text[60] = ";".join([*text[60].split(";")[:4], "1,234"])
    assert imported(arm, text) == 2
    assert arm.is_refused("line 61", "'1,234'", "decimal")


ISO = {
    "Z": lambda t: t.isoformat().replace("+00:00", "Z"),
    "zone": lambda t: t.isoformat(),
    "no zone": lambda t: t.replace(tzinfo=None).isoformat(),
    "a space": lambda t: t.isoformat(" "),
    "a comma": lambda t: t.isoformat().replace(".", ","),
}


@pytest.mark.parametrize("form", ISO)
def test_times_in_iso_8601_are_read(arm, form):
    start_s = 1_760_000_010.25
    at = [datetime.fromtimestamp(round(start_s + t, 6), UTC) for t in T.tolist()]
    rows = [
        ";".join([ISO[form](t), *map(repr, row[1:])])
        for t, row in zip(at, VALUES.tolist(), strict=True)
    ]
    mapping = json.loads(json.dumps(MAPPING))
    assert imported(arm, [";".join(NAMES), *rows], mapping) == 2
    assert arm.is_refused("unit: iso")
    mapping["joints"]["time"]["unit"] = "iso"
    assert imported(arm, [";".join(NAMES), *rows], mapping) == 0
    found = [item.t_ns for item in messages(arm.out, ["/samples/joints"])]
    expected = [round(t.timestamp() * 1e6) * 1000 for t in at]
    assert max(abs(a - b) for a, b in zip(found, expected, strict=True)) < 500
    assert ("read as UTC" in arm.said) == (form == "no zone")


def test_a_time_of_day_is_no_time(arm):
    mapping = json.loads(json.dumps(MAPPING).replace('"unit": "s"', '"unit": "iso"'))
    rows = [",".join(["08:53:30.042", *map(repr, row[1:])]) for row in VALUES.tolist()]
    assert imported(arm, [",".join(NAMES), *rows], mapping) == 2
    assert arm.is_refused("line 2", "ISO 8601")


def test_a_recording_in_several_files_is_one(arm):
    text = lines()
    for name, rows in (("a.csv", text[:150]), ("b.csv", [text[0], *text[150:]])):
        (arm.folder / name).write_text("\n".join(rows) + "\n")
    mapping = json.loads(json.dumps(MAPPING))
    mapping["joints"]["file"] = ["a.csv", "b.csv"]
    path = arm.folder / "map.yaml"
    path.write_text(yaml.safe_dump(mapping))
    assert arm("--map", str(path)) == 0
    assert [row["j1"] for row in positions(arm)] == VALUES[:, 1].tolist()


def test_positions_and_torques_may_be_in_files_of_their_own(arm):
    for name, columns in (("q.csv", [0, 1, 2]), ("tau.csv", [0, 3, 4])):
        own = lines(VALUES[:, columns], [NAMES[k] for k in columns])
        (arm.folder / name).write_text("\n".join(own) + "\n")
    mapping = json.loads(json.dumps(MAPPING))
    mapping["joints"]["torque"]["file"] = "tau.csv"
    assert arm.table(arm.folder / "q.csv", mapping) == 0
    found = [json.loads(item.data) for item in messages(arm.out, ["/samples/joints"])]
    assert [row["torque_nm"]["j2"] for row in found] == VALUES[:, 4].tolist()


def test_files_of_one_section_with_other_stamps_or_lengths_are_refused(arm):
    (arm.folder / "q.csv").write_text("\n".join(lines(VALUES[:, :3], NAMES[:3])) + "\n")
    mapping = json.loads(json.dumps(MAPPING))
    mapping["joints"]["torque"]["file"] = "tau.csv"
    columns = [NAMES[k] for k in (0, 3, 4)]
    later = VALUES[:, [0, 3, 4]] + [[0.01, 0.0, 0.0]]
    for values, words in ((later, "differs"), (VALUES[:-1, [0, 3, 4]], "must be as many")):
        (arm.folder / "tau.csv").write_text("\n".join(lines(values, columns)) + "\n")
        assert arm.table(arm.folder / "q.csv", mapping) == 2
        assert arm.is_refused("tau.csv", words)


@pytest.mark.parametrize("kind", ["differences", "zeros", "constant differences"])
def test_stamps_that_are_differences_or_one_value_are_refused(arm, kind):
    values = VALUES.copy()
    rng = np.random.default_rng(3)
    values[:, 0] = {
        "differences": np.abs(rng.normal(1 / SAMPLES_HZ, 1e-3, ROWS)),
        "zeros": np.zeros(ROWS),
        "constant differences": np.full(ROWS, 1 / SAMPLES_HZ),
    }[kind]
    assert imported(arm, lines(values)) == 2
    assert arm.is_refused("differences" if kind == "differences" else "all 300 stamps are")


# angles that wrap


def wrapped(low: float, turn: float = tau) -> np.ndarray:
    """Return the table with a joint that turns on and on, as an encoder of one turn reads it."""
    values = VALUES.copy()
    values[:, 1] = (0.9 * T + 0.2 * np.sin(2 * T) - low) % turn + low
    return values


@pytest.mark.parametrize(("low", "unit"), [(-pi, "rad"), (0.0, "rad"), (-180.0, "deg")])
def test_a_wrapped_angle_is_unwrapped_and_counted(arm, low, unit):
    values = wrapped(-pi if unit == "deg" else low)
    count = int((np.abs(np.diff(values[:, 1])) > pi).sum())
    assert count >= 1
    mapping = json.loads(json.dumps(MAPPING))
    if unit == "deg":
        values[:, 1:3] = np.degrees(values[:, 1:3])
        mapping["joints"]["position"]["unit"] = "deg"
    assert imported(arm, lines(values), mapping) == 0
    assert f"q_j1 wraps at 2 pi, unwrapped: {count}" in arm.said
    assert "jumps" not in arm.said
    assert "rejected" not in arm.said
    found = np.array([row["j1"] for row in positions(arm)])
    expected = 0.9 * T + 0.2 * np.sin(2 * T)
    assert np.abs(np.diff(found - expected)).max() < 1e-9


def test_rows_in_disorder_and_gaps_at_the_wrap_are_unwrapped(arm):
    values = np.delete(wrapped(-pi), [103, 104, 105, 106], axis=0)
    values[[110, 111]] = values[[111, 110]]
    assert imported(arm, lines(values)) == 0
    found = np.array([row["j1"] for row in positions(arm)])
    t = np.sort(values[:, 0])
    assert np.abs(np.diff(found - 0.9 * t - 0.2 * np.sin(2 * t))).max() < 1e-9


def test_a_jump_that_is_no_turn_stays_a_jump(arm):
    values = VALUES.copy()
    values[150:, 1] += 4.0
    assert imported(arm, lines(values)) == 0
    assert "wraps" not in arm.said
    assert "jumps of q_j1 that 1 rad/s do not allow: 1" in arm.said


@pytest.mark.parametrize(("declared", "count"), [(True, 1), ([True, False], 1), (False, 0)])
def test_a_user_declares_whether_angles_wrap(arm, declared, count):
    mapping = json.loads(json.dumps(MAPPING))
    mapping["joints"]["position"]["wraps"] = declared
    assert imported(arm, lines(wrapped(-pi)), mapping) == 0
    assert ("q_j1 wraps at 2 pi" in arm.said) == bool(count)
    assert ("jumps of q_j1" in arm.said) == (not count)


# joints that slide


RAIL = {
    "joints": {
        "time": {"column": "t", "unit": "s"},
        "position": {"columns": "q_{}", "unit": ["rad", "mm"]},
        "torque": {"columns": "tau_{}", "unit": ["N m", "N"]},
    }
}


@pytest.fixture
def rail(importing: Callable[..., Import]) -> Import:  # noqa: F811
    return importing(sampled=True, kinds=("revolute", "prismatic"))


def test_a_rail_is_mapped_in_millimetres_and_newtons(rail, capsys):
    values = VALUES.copy()
    values[:, 2] *= 1e3
    assert imported(rail, lines(values), RAIL) == 0
    assert [row["j1"] for row in positions(rail)] == VALUES[:, 1].tolist()
    assert np.allclose([row["j2"] for row in positions(rail, "position_m")], VALUES[:, 2])
    found = [json.loads(item.data) for item in messages(rail.out, ["/samples/joints"])]
    assert [row["force_n"]["j2"] for row in found] == VALUES[:, 4].tolist()
    assert "position_m up to 0.1 m, torque_nm up to 3 N m, force_n up to 6 N" in rail.said
    capsys.readouterr()
    assert main(["replay", str(rail.out), "--json"]) in (0, 1)
    samples = json.loads(capsys.readouterr().out.splitlines()[-1])["samples"]["joints"]
    assert samples["accepted"] == 2 * ROWS


def test_a_rail_is_never_unwrapped_and_its_jumps_are_in_metres(rail):
    values = VALUES.copy()
    values[150:, 2] += tau
    mapping = json.loads(json.dumps(RAIL).replace("mm", "m"))
    assert imported(rail, lines(values), mapping) == 0
    assert "wraps" not in rail.said
    step_m = np.abs(np.diff(values[:, 2])).max()
    assert f"jumps of q_j2 that 1 m/s do not allow: 1, the largest {step_m:.3g} m" in rail.said
    mapping["joints"]["position"]["wraps"] = True
    rail.out.unlink()
    assert imported(rail, lines(values), mapping) == 2
    assert rail.is_refused("joints.position.wraps: j2 is prismatic")


@pytest.mark.parametrize(
    ("quantity", "unit", "words"),
    [
        ("position", "rad", "joints.position.unit: 'rad' for j2, which is prismatic"),
        ("position", ["m", "m"], "joints.position.unit: 'm' for j1, which is revolute"),
        ("torque", "N m", "joints.torque.unit: 'N m' for j2, which is prismatic; must be N or mN"),
        ("position", ["rad", "m", "m"], "joints.position.unit: 3 values; must be 1 or 2"),
        ("position", "inch", "joints.position.unit: must be"),
    ],
)
def test_a_unit_that_does_not_fit_the_joint_is_refused(rail, quantity, unit, words):
    mapping = json.loads(json.dumps(RAIL))
    mapping["joints"][quantity]["unit"] = unit
    assert imported(rail, lines(), mapping) == 2
    assert rail.is_refused(words)


def test_values_of_a_rail_out_of_range_are_in_its_units(rail):
    values = VALUES.copy()
    values[20, 2], values[30, 4] = 5e3, 70.0
    mapping = json.loads(json.dumps(RAIL).replace("mm", "m"))
    assert imported(rail, lines(values), mapping) == 0
    assert "rejected of q_j2: 1 out of reach at 1 m/s" in rail.said
    assert "rejected of tau_j2: 1 beyond 50 N;" in rail.said.replace(", from", ";")


def test_steps_between_rows_are_those_of_the_times():
    """Guard of this file: the stamps of the table are those of the declared rate."""
    assert all(b - a == pytest.approx(1 / SAMPLES_HZ) for a, b in pairwise(T.tolist()))
