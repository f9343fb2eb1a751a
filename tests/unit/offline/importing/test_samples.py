"""Mapped columns with values that no sensor can have given: rejected, counted and named."""

from pathlib import Path

import numpy as np
import pytest

from fsw.config import Config
from fsw.config.joints import WITHOUT_TORQUE
from fsw.errors import ConfigError
from offline.importing.captures import Channel
from offline.importing.mapping import Mapping
from offline.importing.samples import sampled_channels
from offline.importing.usable import UNIT
from tests.support.estimator_cases import make_config
from tests.support.wheel_cases import config_with_wheels

ROWS = 60
TIME = {"column": "t", "unit": "s"}
MAPPINGS = {
    "joints": {
        "position": {"columns": "q_{}", "unit": "rad"},
        "torque": {"columns": "tau_{}", "unit": "N m"},
    },
    "imu": {
        "rate": {"columns": "w{}", "unit": "rad/s"},
        "specific_force": {"columns": "f{}", "unit": "m/s2"},
    },
    "wheels": {"speed": {"columns": "speed_{}", "unit": "rad/s"}},
    "star_tracker": {"quaternion": {"columns": "o{}", "order": "xyzw"}},
}
Table = dict[str, list[str]]


def table_of(config: Config, rate_hz: float) -> Table:
    """Return cells of every column: random values that sensors can give."""
    rng = np.random.default_rng(3)
    names = [f"{kind}_{joint.name}" for kind in ("q", "tau") for joint in config.joints]
    names += [f"{kind}{axis}" for kind in "wf" for axis in "xyz"]
    names += [f"speed_{wheel.name}" for wheel in config.wheels]
    table = {name: [repr(float(x)) for x in rng.normal(0, 0.01, ROWS)] for name in names}
    turns = np.array([[0.6, 0.0, 0.0, 0.8], [0.0, 0.6, 0.0, 0.8]])
    for k, axis in enumerate("xyzw"):
        table[f"o{axis}"] = [repr(float(turns[row % 2, k])) for row in range(ROWS)]
    return {"t": [repr(row / rate_hz) for row in range(ROWS)]} | table


def channel(config: Config, folder: Path, section: str, table: Table) -> Channel:
    lines = [",".join(table), *(",".join(row) for row in zip(*table.values(), strict=True))]
    path = folder / "d.csv"
    path.write_text("\n".join(lines) + "\n")
    mapping = Mapping.model_validate({"time": TIME, section: MAPPINGS[section]})
    (found,) = sampled_channels(config, mapping, folder, path)
    return found


def case(section: str) -> tuple[Config, Table]:
    config = config_with_wheels() if section == "wheels" else make_config()
    rates = {"joints": config.buses[0].rate_hz, "imu": config.imu.rate_hz, "wheels": 50.0}
    return config, table_of(config, rates.get(section, 10.0))


def test_good_columns_have_nothing_rejected(tmp_path: Path) -> None:
    for section in ("joints", "imu", "wheels"):
        text = channel(*_at(case(section), tmp_path, section)).text
        assert "rejected" not in text
        assert "left out" not in text


def _at(made: tuple[Config, Table], folder: Path, section: str) -> tuple[Config, Path, str, Table]:
    return made[0], folder, section, made[1]


SPOILT = {  # section, column, its bound in words, whether the row goes with the value
    "position": ("joints", "q_joint2", "out of reach at", True),
    "torque": ("joints", "tau_joint2", "beyond", False),
    "rate": ("imu", "wy", "beyond", False),
    "specific force": ("imu", "fy", "beyond", False),
    "speed of a wheel": ("wheels", "speed_wheel2", "beyond 700 rad/s", True),
    "quaternion": ("star_tracker", "oy", "not of length 1", True),
}


@pytest.mark.parametrize("name", SPOILT)
def test_bad_values_are_counted_by_column_and_kind_and_left_out(name: str, tmp_path: Path) -> None:
    section, column, bound, is_row = SPOILT[name]
    config, table = case(section)
    if section == "star_tracker":
        config = config.model_copy(update={"star_tracker": None})
    for row, cell in (
        (10, "nan"),
        (13, ""),
        (16, "inf"),
        (19, "-inf"),
        (22, "1e300"),
        (25, "-2e9"),
    ):
        table[column][row] = cell
    found = channel(config, tmp_path, section, table)
    line = next(part for part in found.text.split("; ") if f"of {column}: " in part)
    assert "2 not a number, 2 infinite, 2 " in line
    assert bound in line
    assert ("left out: 6" in found.text) == is_row
    assert "inf " not in found.text
    assert "e+300" not in found.text


@pytest.mark.parametrize("name", [name for name in SPOILT if name != "quaternion"])
@pytest.mark.parametrize(
    ("cell", "words"), [("", "60 not a number"), ("inf", "60 infinite"), ("1e300", "60 ")]
)
def test_a_column_without_any_usable_value_is_an_error(
    name: str, cell: str, words: str, tmp_path: Path
) -> None:
    section, column, _, _ = SPOILT[name]
    config, table = case(section)
    table[column] = [cell] * ROWS
    with pytest.raises(ConfigError, match=f"'{column}' has no usable value: {words}"):
        channel(config, tmp_path, section, table)


def test_a_row_without_any_value_is_counted_once_not_by_column(tmp_path: Path) -> None:
    config, table = case("imu")
    for name in table:
        if name[0] in "wf":
            table[name][30] = ""
    text = channel(config, tmp_path, "imu", table).text
    assert "rows without any value, left out: 1" in text
    assert "rejected" not in text


def test_a_source_that_the_configuration_lacks_is_named_by_its_key(tmp_path: Path) -> None:
    config, table = make_config(), case("wheels")[1]
    assert not config.wheels
    with pytest.raises(ConfigError, match=r"wheels\.speed: mapped, and the conf.* has no wheels$"):
        channel(config, tmp_path, "wheels", table)


@pytest.mark.parametrize("section", ["joints", "imu"])
def test_many_values_that_no_sensor_gives_ask_for_the_unit(section: str, tmp_path: Path) -> None:
    """Degrees as radians: out of reach, and too fast from row to row."""
    config, table = case(section)
    table |= {name: [repr(1e-4 * row) for row in range(ROWS)] for name in table if name[0] == "q"}
    assert UNIT not in channel(config, tmp_path, section, table).text
    lasted_s = ROWS / config.buses[0].rate_hz
    most = {
        "joints": config.joints[1].speed_limit_rad_s * lasted_s,
        "imu": config.imu.max_rate_rad_s,
    }
    name = {"joints": "q_joint2", "imu": "wx"}[section]
    swing = [3.0 * most[section] * np.sin(0.3 * row) for row in range(ROWS)]
    table[name] = [repr(float(value)) for value in swing]
    assert UNIT in channel(config, tmp_path, section, table).text


def test_jumps_of_a_position_are_counted_and_stay(tmp_path: Path) -> None:
    """A joint goes 2 speed_limit_rad_s period in a period at most; a spike is two jumps."""
    config, table = case("joints")
    joint = config.joints[1]
    allowed_rad = 2.0 * joint.speed_limit_rad_s / config.buses[0].rate_hz
    names = [name for name in table if name.startswith("q_")]
    for place, name in enumerate(names):
        table[name] = [repr(1e-6 * (row + place)) for row in range(ROWS)]
    table["q_joint2"][20] = repr(1e-6 * 21 + 0.95 * allowed_rad)
    assert "jumps" not in channel(config, tmp_path, "joints", table).text
    table["q_joint2"][40] = repr(1e-6 * 41 + 1.2 * allowed_rad)
    found = channel(config, tmp_path, "joints", table)
    words = f"jumps of q_joint2 that {joint.speed_limit_rad_s:g} rad/s do not allow: 2, the largest"
    assert words in found.text
    assert len(found.t_ns) == ROWS


def moving(table: Table) -> None:
    """Give all joints a smooth motion and torque."""
    for name in table:
        if name.startswith(("q_", "tau_")):
            table[name] = [repr(float(x)) for x in 0.01 * np.sin(0.02 * np.arange(ROWS))]


@pytest.mark.parametrize("column", ["q_joint3", "tau_joint3"])
@pytest.mark.parametrize("shift_s", [0.0, 1e-3, 0.5])
def test_two_publishers_on_one_topic_are_refused(tmp_path: Path, column, shift_s) -> None:
    """Every second row is of another program, at the same time, soon after, or half a period."""
    config, table = case("joints")
    period_s = 1.0 / config.buses[0].rate_hz
    moving(table)
    times = np.arange(ROWS) // 2 * 2.0 * period_s
    times[1::2] += 2.0 * period_s * shift_s
    table["t"] = [repr(float(t)) for t in times]
    for row in range(1, ROWS, 2):
        table[column][row] = repr(float(table[column][row]) + 0.02)
    words = f"d.csv: {column}: every second row follows another course, 0.02 away: do two programs"
    with pytest.raises(ConfigError, match=words):
        channel(config, tmp_path, "joints", table)


def test_rounded_noise_of_a_sensor_at_rest_is_one_course(tmp_path: Path) -> None:
    """Of the steps just over half are one digit, of those over two rows just under half."""
    config, table = case("joints")
    moving(table)
    digits = np.random.default_rng(4).integers(0, 2, ROWS)
    near, next_but_one = (float(np.median(np.abs(digits[k:] - digits[:-k]))) for k in (1, 2))
    assert (near, next_but_one) == (1.0, 0.0)
    table["tau_joint3"] = [repr(0.01 * int(digit)) for digit in digits]
    assert len(channel(config, tmp_path, "joints", table).t_ns) == ROWS


def test_torques_that_never_come_with_positions_are_refused(tmp_path: Path) -> None:
    config, table = case("joints")
    moving(table)
    for row in range(ROWS):
        for name in table:
            if name.startswith("q_" if row % 2 else "tau_"):
                table[name][row] = ""
    with pytest.raises(ConfigError, match="no row holds tau_joint1 with all positions"):
        channel(config, tmp_path, "joints", table)


def test_a_torque_that_never_changes_is_named(tmp_path: Path) -> None:
    config, table = case("joints")
    moving(table)
    assert "in every row" not in channel(config, tmp_path, "joints", table).text
    table["tau_joint2"] = ["0.0"] * ROWS
    text = channel(config, tmp_path, "joints", table).text
    assert "tau_joint2 is 0 N m in every row: is it measured?" in text
    blind = [joint.model_dump() for joint in config.joints]
    blind[1] |= {"torque": "none", **WITHOUT_TORQUE}
    text = channel(config.with_sections(joints=blind), tmp_path, "joints", table).text
    assert "in every row" not in text


@pytest.mark.parametrize("short", ["q", "tau", "t"])
def test_arrays_of_different_lengths_are_refused(tmp_path: Path, short: str) -> None:
    config, held = case("joints")
    moving(held)
    numbers = {name: np.array(cells, float) for name, cells in held.items()}
    arrays = {
        key: np.column_stack([numbers[f"{key}_{joint.name}"] for joint in config.joints])
        for key in ("q", "tau")
    } | {"t": numbers["t"]}
    arrays[short] = arrays[short][:-1]
    np.savez(tmp_path / "d.npz", **arrays)
    columns = {"position": {"columns": "q", "unit": "rad"}}
    columns |= {"torque": {"columns": "tau", "unit": "N m"}}
    mapping = Mapping.model_validate({"time": TIME, "joints": columns})
    with pytest.raises(ConfigError, match=f"rows, and 't' has {ROWS - (short == 't')}; must be as"):
        list(sampled_channels(config, mapping, tmp_path, tmp_path / "d.npz"))


def test_poses_may_be_in_a_file_of_their_own(tmp_path: Path) -> None:
    config, table = case("joints")
    table.pop("t")
    lines = [",".join(table), *(",".join(row) for row in zip(*table.values(), strict=True))]
    for name in ("d.csv", "e.csv"):
        (tmp_path / name).write_text("\n".join(lines) + "\n")
    columns = MAPPINGS["joints"] | {"poses": True}
    columns["position"] = columns["position"] | {"file": "e.csv"}
    mapping = Mapping.model_validate({"joints": columns})
    (found,) = sampled_channels(config, mapping, tmp_path, tmp_path / "d.csv")
    assert len(found.t_ns) > ROWS
