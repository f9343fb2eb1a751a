"""`fsw import` of sampled data: irregular, 30 Hz, units and signs of others.

Bound, set before the first run: CSV, .npz and a ROS 2 bag of the same samples agree within 0.01
sigma, the microsecond to which stamps are kept.
"""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml

from fsw.__main__ import main
from fsw.drivers.sources.samples import imu_samples
from fsw.drivers.wire import ByteChunk
from fsw.exchange.recording import contents, messages
from hil.run.bench import Setup, prepare
from tests.support.sampled_cases import (
    EPOCH_S,
    Columns,
    faults,
    sampled,
    sampled_config,
    write_bag,
    write_csv,
)
from tests.support.short_cases import short

NAMES = [f"joint{k}" for k in range(1, 8)]
SECONDS = {"column": "t", "unit": "s"}
JOINTS = {
    "time": SECONDS,
    "file": "joints.csv",
    "position": {"columns": "q_{}", "unit": "rad"},
    "torque": {"columns": "tau_{}", "unit": "N m"},
}
IMU = {
    "time": SECONDS,
    "file": "imu.csv",
    "rate": {"columns": "w{}", "unit": "rad/s"},
    "specific_force": {"columns": "f{}", "unit": "m/s2"},
}
ROS = """
joints:
  time: {column: /joint_states.stamp, unit: s}
  position: {columns: "/joint_states.position.{}", unit: rad}
  torque: {columns: "/joint_states.effort.{}", unit: "N m"}
imu:
  time: {column: /imu.stamp, unit: s}
  rate: {columns: "/imu.angular_velocity.{}", unit: rad/s}
  specific_force: {columns: "/imu.linear_acceleration.{}", unit: m/s2}
"""


@dataclass(frozen=True)
class Laboratory:
    setup: Setup
    config: Path
    joints: Columns
    imu: Columns


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Laboratory:
    folder = tmp_path_factory.mktemp("lab")
    setup = prepare(short(folder, hurry=2.0, name="bench_target"), 1, folder)
    config = sampled_config(setup)
    return Laboratory(setup, config, *sampled(setup, config, 1))


def imported(lab: Laboratory, folder: Path, mapping: object, *more: str) -> int:
    """Write both CSVs and the mapping where they are missing, and import them."""
    for name, columns in (("joints.csv", lab.joints), ("imu.csv", lab.imu)):
        if not (folder / name).exists():
            write_csv(folder / name, columns)
    path = folder / "map.yaml"
    path.write_text(mapping if isinstance(mapping, str) else yaml.safe_dump(mapping))
    out = str(folder / "out.mcap")
    return main(["import", "--map", str(path), "--config", str(lab.config), "--out", out, *more])


def identified(lab: Laboratory, folder: Path, capsys: pytest.CaptureFixture[str]) -> dict:
    capsys.readouterr()
    main(["identify", str(folder / "out.mcap"), "--config", str(lab.config), "--json"])
    return json.loads(capsys.readouterr().out)


def rows(path: Path, source: str) -> list[dict]:
    return [json.loads(item.data) for item in messages(path, [f"/samples/{source}"])]


@pytest.mark.slow
def test_csv_npz_and_a_ros_2_bag_of_the_same_samples_agree(lab, tmp_path, capsys):
    (tmp_path / "csv").mkdir()
    assert imported(lab, tmp_path / "csv", {"joints": JOINTS, "imu": IMU}) == 0
    ours = identified(lab, tmp_path / "csv", capsys)
    (tmp_path / "npz").mkdir()
    arrays = {
        "q": np.column_stack([lab.joints[f"q_{name}"] for name in NAMES]),
        "tau": np.column_stack([lab.joints[f"tau_{name}"] for name in NAMES]),
        "t_ns": np.rint((lab.joints["t"] + EPOCH_S) * 1e9).astype(np.int64),
        "t_imu": lab.imu["t"] + EPOCH_S,
        **{f"{kind}{axis}": lab.imu[f"{kind}{axis}"] for kind in "wf" for axis in "xyz"},
    }
    np.savez(tmp_path / "data.npz", **arrays)
    joints = {
        "time": {"column": "t_ns", "unit": "ns"},
        "position": {"columns": "q", "unit": "rad"},
        "torque": {"columns": ["tau"], "unit": "N m"},
    }
    imu = {key: value for key, value in IMU.items() if key != "file"}
    imu["time"] = {"column": "t_imu", "unit": "s"}
    data = str(tmp_path / "data.npz")
    assert imported(lab, tmp_path / "npz", {"joints": joints, "imu": imu}, data) == 0
    (tmp_path / "ros").mkdir()
    bag = write_bag(tmp_path / "bag", lab.joints, lab.imu, NAMES)
    assert imported(lab, tmp_path / "ros", ROS, str(bag)) == 0
    sigma = np.sqrt(np.diag(ours["covariance"]))
    for form in ("npz", "ros"):
        theirs = identified(lab, tmp_path / form, capsys)
        assert theirs["samples"]["joints"]["accepted"] == ours["samples"]["joints"]["accepted"]
        assert np.abs((np.array(theirs["mean"]) - ours["mean"]) / sigma).max() < 0.01


def test_a_bag_of_one_file_is_read_like_its_folder(lab, tmp_path):
    bag = write_bag(tmp_path / "bag", lab.joints, lab.imu, NAMES)
    assert imported(lab, tmp_path, ROS, str(bag)) == 0
    whole = rows(tmp_path / "out.mcap", "imu")
    (tmp_path / "out.mcap").unlink()
    assert imported(lab, tmp_path, ROS, str(next(bag.glob("*.mcap")))) == 0
    assert rows(tmp_path / "out.mcap", "imu") == whole
    assert len(whole) > 50


def test_the_example_of_the_documentation_is_imported(lab, tmp_path):
    page = (Path(__file__).parents[3] / "docs" / "import.md").read_text()
    example, ros = (part.split("```")[0] for part in page.split("```yaml\n")[1:])
    assert yaml.safe_load(ros) == yaml.safe_load(ROS)
    signs = yaml.safe_load(example)["joints"]["torque"]["sign"]
    table = {"time_ms": lab.joints["t"] * 1e3}
    table |= {f"pos_{name}": np.degrees(lab.joints[f"q_{name}"]) for name in NAMES}
    for name, sign in zip(NAMES, signs, strict=True):
        table[f"tau_{name}"] = sign * lab.joints[f"tau_{name}"]
    write_csv(tmp_path / "arm.csv", table)
    inertial = {"t": lab.imu["t"]}
    inertial |= {f"g{axis}": np.degrees(lab.imu[f"w{axis}"]) for axis in "xyz"}
    inertial |= {f"f{axis}": lab.imu[f"f{axis}"] / 9.80665 for axis in "xyz"}
    write_csv(tmp_path / "imu.csv", inertial)
    assert imported(lab, tmp_path, example, str(tmp_path / "arm.csv")) == 0
    joints, imu = (rows(tmp_path / "out.mcap", source) for source in ("joints", "imu"))
    for kind, key in (("q", "position_rad"), ("tau", "torque_nm")):
        for name in NAMES:
            assert np.allclose([row[key][name] for row in joints], lab.joints[f"{kind}_{name}"])
    assert np.allclose([row["w_NS_S_rad_s"][2] for row in imu], lab.imu["wz"])
    assert np.allclose([row["f_NS_S_m_s2"][0] for row in imu], lab.imu["fx"])
    held = contents(tmp_path / "out.mcap")
    assert held.metadata["samples"]["joints"].split() == NAMES


def test_stamps_are_judged_in_one_line_and_put_right(lab, tmp_path, capsys):
    place = list(range(len(lab.joints["t"])))
    place[10:12] = [11, 10]
    del place[30:40]
    place.insert(20, place[20])
    columns = {key: values[place].copy() for key, values in lab.joints.items()}
    for key, values in columns.items():
        values[51] = values[50] if key != "t" else values[51]
    columns["q_joint1"][20] += 1e-4  # another reading at the same time
    write_csv(tmp_path / "joints.csv", columns)
    assert imported(lab, tmp_path, {"joints": JOINTS, "imu": IMU}) == 0
    line = next(x for x in capsys.readouterr().out.splitlines() if "/samples/joints" in x)
    for words in (
        "jitter",
        "the row before, left out: 1",
        "of another row, left out: 1",
        "sorted: 1",
    ):
        assert words in line
    assert "gaps: " in line
    stamps = [m.t_ns for m in messages(tmp_path / "out.mcap", ["/samples/joints"])]
    assert (np.diff(stamps) > 0).all()
    assert len(stamps) == len(place) - 2


def test_a_replay_works_the_same_windows(lab, tmp_path, capsys):
    assert imported(lab, tmp_path, {"joints": JOINTS, "imu": IMU}) == 0
    found = identified(lab, tmp_path, capsys)
    main(["replay", str(tmp_path / "out.mcap"), "--json"])  # with the configuration inside
    result = json.loads(capsys.readouterr().out)
    assert result["samples"] == found["samples"]
    assert result["windows"]["closed"] - result["windows"]["unusable"] > 5
    assert main(["check", str(lab.config), str(tmp_path / "out.mcap")]) in (0, 1)
    assert "buses.0.rate_hz: declared 30" in capsys.readouterr().out


def test_another_robots_recording_is_refused_in_one_line(lab, tmp_path, capsys):
    assert imported(lab, tmp_path, {"joints": JOINTS, "imu": IMU}) == 0
    capsys.readouterr()
    data = yaml.safe_load(lab.config.read_text())
    data["robot"]["urdf"] = str(tmp_path / "other.urdf")
    text = (lab.config.parent / "robot.urdf").read_text().replace('"joint3"', '"elbow"')
    (tmp_path / "other.urdf").write_text(text)
    data["joints"][2]["name"] = "elbow"
    (tmp_path / "other.yaml").write_text(yaml.safe_dump(data))
    for command in ("identify", "replay"):
        arguments = [command, str(tmp_path / "out.mcap"), "--config", str(tmp_path / "other.yaml")]
        assert main(arguments) == 2
        said = capsys.readouterr().err
        assert ("another robot" in said, len(faults(said))) == (True, 1)


def without(section: dict, key: str) -> dict:
    return {name: value for name, value in section.items() if name != key}


ANGLES, TORQUES = JOINTS["position"], JOINTS["torque"]
WRONG_MAPPINGS = {
    "no column": ({"position": ANGLES | {"columns": "qq_{}"}}, "no column 'qq_joint1'; did you"),
    "too few": ({"position": ANGLES | {"columns": ["q_joint1"]}}, "1 columns; must be 7"),
    "unit": (
        {"position": ANGLES | {"unit": "grad"}},
        "joints.position.unit: must be 'rad'",
    ),
    "order": ({"order": [*NAMES[:6], "wrist"]}, "the mapping of another robot"),
    "key": ({"positions": ANGLES}, "joints.positions: unknown key"),
    "signs": ({"position": ANGLES | {"sign": [1, -1]}}, "joints.position.sign: 2 values"),
    "zero sign": ({"position": ANGLES | {"sign": 0}}, "joints.position.sign"),
    "time": ({"time": {"column": "when", "unit": "s"}}, "no column 'when'"),
    "rate": ({"time": SECONDS | {"unit": "ms"}}, "correct the unit of time"),
    "file": ({"file": "missing.csv"}, "missing.csv: cannot be read: No such file"),
    "bag": ({"file": "missing"}, "missing: cannot be read as a ROS 2 bag"),
    "no torque": ({"torque": None}, "joints.torque: missing; joint1 joint2"),
}


@pytest.mark.parametrize("name", WRONG_MAPPINGS)
def test_a_wrong_mapping_is_one_line_and_nothing_is_written(lab, tmp_path, name, capsys):
    change, words = WRONG_MAPPINGS[name]
    assert imported(lab, tmp_path, {"joints": JOINTS | change, "imu": IMU}) == 2
    said = capsys.readouterr()
    assert words in said.err
    assert (said.out, len(faults(said.err))) == ("", 1)
    assert not list(tmp_path.glob("out*"))


def test_wheels_that_the_configuration_has_not_are_named_by_their_key(lab, tmp_path, capsys):
    wheels = JOINTS | {"speed": {"columns": "q_joint1", "unit": "rad/s"}}
    wheels = without(without(wheels, "position"), "torque")
    assert imported(lab, tmp_path, {"joints": JOINTS, "imu": IMU, "wheels": wheels}) == 2
    said = capsys.readouterr().err
    assert ("wheels.speed: mapped" in said, len(faults(said))) == (True, 1)


def test_no_time_no_mapping_and_no_file_are_named(lab, tmp_path, capsys):
    assert imported(lab, tmp_path, {"joints": without(JOINTS, "time"), "imu": IMU}) == 2
    assert "joints.time: missing" in capsys.readouterr().err
    assert imported(lab, tmp_path, {"joints": without(JOINTS, "file"), "imu": IMU}) == 2
    assert "joints.file: missing" in capsys.readouterr().err
    assert imported(lab, tmp_path, {"joints": JOINTS}) == 2
    assert "add --serial imu=FILE, or map them" in capsys.readouterr().err
    out = str(tmp_path / "out.mcap")
    assert main(["import", "a.csv", "--config", str(lab.config), "--out", out]) == 2
    assert "needs --map" in capsys.readouterr().err


def ragged(lines: list[str]) -> str:
    short = [line.rpartition(",")[0] for line in lines[5:25]]
    return "\n".join([*lines[:5], *short, *lines[25:], ""])


def words(lines: list[str]) -> str:
    return "\n".join([*lines[:5], lines[5].replace(lines[5].split(",")[1], "abc"), ""])


def backwards(lines: list[str]) -> str:
    return "\n".join([lines[0], *lines[40:], *lines[1:40], ""])


def upside_down(lines: list[str]) -> str:
    return "\n".join([lines[0], *reversed(lines[1:]), ""])


def held(lines: list[str]) -> str:
    same = lines[1].partition(",")[2]
    return "\n".join([lines[0], *(f"{line.partition(',')[0]},{same}" for line in lines[1:]), ""])


def nothing(_lines: list[str]) -> str:
    return ""


def header_only(lines: list[str]) -> str:
    return lines[0] + "\n"


def no_torque(lines: list[str]) -> str:
    return "\n".join([lines[0], *(f"{line.rpartition(',')[0]},nan" for line in lines[1:]), ""])


WRONG_TABLES = {
    no_torque: "joints.torque: 'tau_joint7' has no usable value: ",
    ragged: "line 6 has 14 values for 15 columns",
    words: "line 6: 'q_joint1' is 'abc'; must be a number",
    backwards: "time runs backwards 1 times",
    upside_down: "put the rows in order of time",
    held: "1 different samples of",
    nothing: "is empty",
    header_only: "is empty below its header",
}


@pytest.mark.parametrize("spoil", WRONG_TABLES, ids=lambda f: f.__name__)
def test_a_wrong_table_is_one_line_and_nothing_is_written(lab, tmp_path, spoil, capsys):
    path = write_csv(tmp_path / "joints.csv", lab.joints)
    path.write_text(spoil(path.read_text().splitlines()))
    assert imported(lab, tmp_path, {"joints": JOINTS, "imu": IMU}) == 2
    said = capsys.readouterr()
    assert WRONG_TABLES[spoil] in said.err
    assert (said.out, len(faults(said.err))) == ("", 1)
    assert not list(tmp_path.glob("out*"))


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9, 0.999])
def test_a_cut_archive_or_bag_is_one_line(lab, tmp_path, keep, capsys):
    bag = write_bag(tmp_path / "bag", lab.joints, lab.imu, NAMES)
    np.savez(tmp_path / "whole.npz", **lab.joints)
    for whole, name, mapping in (
        (next(bag.glob("*.mcap")), "cut.mcap", ROS),
        (tmp_path / "whole.npz", "cut.npz", {"joints": without(JOINTS, "file"), "imu": IMU}),
    ):
        data = whole.read_bytes()
        (tmp_path / name).write_bytes(data[: int(keep * len(data))])
        assert imported(lab, tmp_path, mapping, str(tmp_path / name)) == 2
        said = capsys.readouterr().err
        assert (f"{name}: cannot be read as" in said, len(faults(said))) == (True, 1)
    assert not (tmp_path / "out.mcap").exists()


def test_a_bag_without_rosbags_says_what_to_install(lab, tmp_path, capsys, monkeypatch):
    bag = write_bag(tmp_path / "bag", lab.joints, lab.imu, NAMES)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    assert imported(lab, tmp_path, ROS, str(bag)) == 2
    said = capsys.readouterr().err
    assert "pip install 'inertia-daemon[ros2]'" in said
    assert len(faults(said)) == 1


def test_run_refuses_a_configuration_without_devices(lab, capsys):
    assert main(["run", str(lab.config)]) == 2
    said = capsys.readouterr().err
    assert "buses.0.interface: samples is not a device" in said
    assert "imu.driver: samples is not a device" in said


def test_damaged_sample_messages_are_counted_and_never_raise(lab):
    source = imu_samples(lab.setup.config.imu)
    good = b'{"w_NS_S_rad_s": [0.1, 0, 0], "f_NS_S_m_s2": [0, 0, 9.8]}'
    bad = [
        *(b"", b"\xff", b"[]", b"3", b'{"w_NS_S_rad_s": 3}', b'{"w_NS_S_rad_s": [1, 2]}'),
        *(b'{"w_NS_S_rad_s": ["a", 0, 0]}', b'{"w_NS_S_rad_s": [[1], 0, 0]}'),
        b'{"w_NS_S_rad_s": [1e9, 0, 0]}',
    ]
    samples = source.feed([ByteChunk(k, data) for k, data in enumerate([*bad, good])])
    assert len(samples) == 1
    assert (source.counters["accepted"], source.counters["rejected"]) == (1, len(bad))
    assert len(source.feed([])) == 0
