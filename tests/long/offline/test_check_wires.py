"""Mistakes in the description of drives: `fsw check robot.yaml candump.log` names each one.

Logs that are right agree with their configuration.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from fsw.__main__ import main
from hil.run.bench import Setup, prepare
from tests.support.sampled_cases import EPOCH_S, WINDOW_S, sampled, sampled_config, write_csv
from tests.support.sampled_mistakes import MAPPING
from tests.support.short_cases import short
from tests.support.wired_cases import RATE_HZ, candump, described


@pytest.fixture(scope="module")
def setup(tmp_path_factory: pytest.TempPathFactory) -> Setup:
    folder = tmp_path_factory.mktemp("bench_target")
    return prepare(short(folder, hurry=2.0, name="bench_target"), 1, folder)


def checked(
    setup: Setup, folder: Path, capsys: Any, change: Callable[[Any], None], **log: Any
) -> tuple[int, list[str], str]:
    data = described(setup)
    change(data)
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(data))
    code = main(["check", str(path), str(candump(setup, folder / "candump.log", **log))])
    said = capsys.readouterr()
    return code, said.out.splitlines(), said.err


def wrong(lines: list[str]) -> str:
    return "\n".join(line for line in lines if "WRONG" in line)


def signal(data: Any, name: str, joint: int = 1) -> dict[str, Any]:
    own = data["buses"][0]["messages"][joint]["signals"]
    return next(each for each in own if each["name"] == name)


def use(data: Any, role: str, joint: int = 1) -> dict[str, Any]:
    own: dict[str, Any] = data["joints"][joint]["signals"][role]
    return own


@pytest.mark.parametrize("lost", [0.0, 0.02])
def test_a_log_that_is_right_agrees(setup, lost, tmp_path, capsys):
    code, lines, err = checked(setup, tmp_path, capsys, lambda _: None, lost=lost)
    assert (code, wrong(lines)) == (0, ""), "\n".join([*lines, err])
    assert any("buses.0.rate_hz: declared 100, found 100; fits" in line for line in lines), lines


def degrees_as_rad(data: Any) -> None:
    signal(data, "angle").update({"unit": "rad"})


def rad_as_degrees(data: Any) -> None:
    signal(data, "angle").update({"scale": 1e-4 * 3.141592653589793 / 180.0})


def all_degrees_as_rad(data: Any) -> None:
    for k in range(len(data["joints"])):
        signal(data, "angle", k).update({"unit": "rad"})


def torque_in_mnm(data: Any) -> None:
    signal(data, "torque").update({"scale": 10.0})


def torque_per_mille(data: Any) -> None:
    """The drive sends per mille of 250 N m; it is read as 0.01 N m a step would be, 0.04 times."""
    signal(data, "torque").update({"scale": 4e-4})


def angle_big_endian(data: Any) -> None:
    signal(data, "angle").update({"order": "big", "start": 7})


def torque_big_endian(data: Any) -> None:
    signal(data, "torque").update({"order": "big", "start": 39})


def angle_through_zero_unsigned(data: Any) -> None:
    signal(data, "angle", 0).update({"number": "unsigned"})


def negative_angle_unsigned(data: Any) -> None:
    signal(data, "angle", 4).update({"number": "unsigned"})


def torque_unsigned(data: Any) -> None:
    signal(data, "torque").update({"number": "unsigned"})


def speed_as_angle(data: Any) -> None:
    use(data, "position").update({"signal": "speed", "unit": None})
    signal(data, "speed").update({"unit": "deg"})


def torque_as_angle(data: Any) -> None:
    for name in ("angle", "torque"):
        signal(data, name).update({"unit": ""})
    use(data, "position").update({"signal": "torque", "unit": "rad"})
    use(data, "torque").update({"signal": "angle", "unit": "N m"})


def joints_exchanged(data: Any) -> None:
    for role in ("position", "torque"):
        for one, other in ((1, 2), (2, 1)):
            data["joints"][one]["signals"][role]["message"] = f"drive{other}"


def torques_exchanged(data: Any) -> None:
    for one, other in ((1, 2), (2, 1)):
        data["joints"][one]["signals"]["torque"]["message"] = f"drive{other}"


def counted_the_other_way(data: Any) -> None:
    data["joints"][1]["sign"] *= -1


MISTAKES = {
    degrees_as_rad: ("joints.1", "joint2", "57.3 times too large"),
    rad_as_degrees: ("joints.1", "joint2", "57.3 times too small"),
    all_degrees_as_rad: ("joints: the angles are in degrees",),
    torque_in_mnm: ("joints.1", "torque", "1e+03 times too large"),
    torque_per_mille: ("joints.1", "torque", "times too small"),
    angle_big_endian: ("joints.1.signals.position", "in little-endian byte order"),
    torque_big_endian: ("joints.1.signals.torque", "in little-endian byte order"),
    angle_through_zero_unsigned: ("joints.0.signals.position", "as a signed number"),
    negative_angle_unsigned: ("joints.4.signals.position", "as a signed number"),
    torque_unsigned: ("joints.1.signals.torque", "as a signed number"),
    speed_as_angle: ("joints.1.signals.position", "is the speed of angle"),
    torque_as_angle: ("joints.1.signals.position", "exchanged"),
    joints_exchanged: ("joints.1.signals and joints.2.signals", "swapped"),
    torques_exchanged: ("joints.1 and joints.2", "torques are exchanged"),
    counted_the_other_way: ("joints.1.sign (joint2)",),
}
PAGE = Path(__file__).parents[3] / "docs" / "howto" / "when_wrong.md"
ROW = re.compile(r"^\| (.+?) \| `(.+?)` \| (.+) \|$", re.MULTILINE)
WORDS = {row[0]: row[1] for row in ROW.findall(PAGE.read_text().partition("## Wires")[2])}
ROWS = {
    "a joint in degrees, read as rad": degrees_as_rad,
    "a joint in rad, read as degrees": rad_as_degrees,
    "all joints in degrees, read as rad": all_degrees_as_rad,
    "a torque in mN m, read as N m": torque_in_mnm,
    "a torque per mille, of another rated torque": torque_per_mille,
    "byte order of an angle": angle_big_endian,
    "byte order of a torque": torque_big_endian,
    "a signed angle read as unsigned": negative_angle_unsigned,
    "a signed torque read as unsigned": torque_unsigned,
    "the speed in place of the angle": speed_as_angle,
    "angle and torque exchanged": torque_as_angle,
    "two joints exchanged": joints_exchanged,
    "torques of two joints exchanged": torques_exchanged,
    "a drive that counts the other way": counted_the_other_way,
}
MOTOR, RATE, BEFORE = (
    "torque of the motor, taken for that of the link",
    "another rate of the frames",
    "values of the period before",
)


def test_every_row_of_the_page_is_made_here():
    assert set(WORDS) == {*ROWS, MOTOR, RATE, BEFORE}


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda own: own.__name__)
def test_a_mistake_in_a_description_is_named(setup, mistake, tmp_path, capsys):
    code, lines, err = checked(setup, tmp_path, capsys, mistake)
    said = wrong(lines)
    rows = [WORDS[row] for row, own in ROWS.items() if own is mistake]
    missing = [words for words in (*MISTAKES[mistake], *rows) if words not in said]
    assert (code, missing) == (1, []), "\n".join([*lines, err])


@pytest.mark.parametrize("rate_hz", [99.0, 100.3])
def test_a_rate_that_is_off_is_found_as_it_is(setup, rate_hz, tmp_path, capsys):
    code, lines, err = checked(setup, tmp_path, capsys, lambda _: None, rate_hz=rate_hz, lost=0.02)
    assert code == 1, "\n".join([*lines, err])
    own = next(line for line in lines if "buses.0.rate_hz" in line)
    found = float(own.rpartition(" come at ")[2].split()[0])
    assert abs(found / rate_hz - 1.0) < 1e-4, own
    assert WORDS[RATE] in own


def test_torques_of_motors_are_named(setup, tmp_path, capsys):
    code, lines, err = checked(setup, tmp_path, capsys, lambda _: None, is_motor=True)
    assert (code, WORDS[MOTOR] in wrong(lines)) == (1, True), "\n".join([*lines, err])


def test_a_log_without_the_other_sensors_is_judged_by_its_frames(setup, tmp_path, capsys):
    """A floating robot's signs need its inertial unit; its wires do not."""

    def floating(data: Any) -> None:
        given = yaml.safe_load(setup.config_path.read_text())
        data["imu"] = given["imu"]
        angle_big_endian(data)

    code, lines, err = checked(setup, tmp_path, capsys, floating)
    assert code == 1, err
    assert "joints.1.signals.position" in wrong(lines), "\n".join(lines)
    assert any("fsw import" in line for line in lines), lines


def test_positions_and_torques_of_the_period_before_are_named(tmp_path, capsys):
    """The inertial unit shows it: its clock seems to differ by one period of the bus."""
    setup = prepare(short(tmp_path, hurry=2.0), 1, tmp_path)
    given = sampled_config(setup)
    imu = sampled(setup, given, 1)[1]
    write_csv(tmp_path / "imu.csv", imu | {"t": imu["t"] + EPOCH_S})
    mapping = {"imu": MAPPING["imu"]}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(mapping))
    data = described(setup, clamped=False)
    data["imu"] = yaml.safe_load(given.read_text())["imu"]
    del data["star_tracker"]
    data["estimator"]["window_s"] = WINDOW_S
    path, out = tmp_path / "robot.yaml", tmp_path / "out.mcap"
    path.write_text(yaml.safe_dump(data))
    log = candump(setup, tmp_path / "candump.log", late_s=1.0 / RATE_HZ)
    arguments = ["--can", f"arm={log}", "--map", str(tmp_path / "map.yaml"), "--config", str(path)]
    assert main(["import", *arguments, "--out", str(out)]) == 0
    capsys.readouterr()
    code = main(["check", str(path), str(out)])
    lines = capsys.readouterr().out.splitlines()
    assert (code, WORDS[BEFORE] in wrong(lines)) == (1, True), "\n".join(lines)
