"""`fsw init --recording`: configuration and mapping from a file, which import and check accept."""

import csv
from pathlib import Path

import can
import numpy as np
import pytest
import yaml

from fsw.__main__ import main
from fsw.config import load
from tests.conftest import arm_urdf
from tests.support.sampled_cases import write_bag

RATE_HZ, SECONDS = 200.0, 8.0
FLAGS = "--tool gripper --unknown target --target-mass-kg 2 --base clamped --tracker none"
MOUNT = "--imu 3dm_cv7 --imu-xyz 0 0 0 --imu-rpy 0 0 0"
JOINTS = ("axis1", "axis2", "axis3")
NOISE_RAD, NOISE_NM = 1e-4, 0.05


def motion(rate_hz: float = RATE_HZ, offset_s: float = 1.7e9):
    """Return times (k,), angles (k, 3), torques (k, 3) of a gentle motion with noise."""
    rng = np.random.default_rng(3)
    t = np.arange(round(rate_hz * SECONDS)) / rate_hz
    q = 0.5 * np.sin(2.0 * t[:, None] * np.array([0.7, 1.1, 1.3]))
    tau = 8.0 * np.cos(q) * np.array([0.2, 1.0, 0.6])
    return (
        t + offset_s,
        q + NOISE_RAD * rng.normal(size=q.shape),
        tau + NOISE_NM * rng.normal(size=q.shape),
    )


def table(path: Path, columns: dict[str, np.ndarray]) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(list(values) for values in columns.values()), strict=True))
    return path


def by_name(t, q, tau):
    columns = {"time": t, **{f"pos_{j}": q[:, k] for k, j in enumerate(JOINTS)}}
    return columns | {f"effort_{j}": tau[:, k] for k, j in enumerate(JOINTS)}


def by_number(t, q, tau):
    columns = {"timestamp_ms": 1e3 * t, **{f"q{k}": q[:, k] for k in range(3)}}
    columns |= {f"qd{k}": q[:, k] for k in range(3)} | {f"target_q{k}": 0 * t for k in range(3)}
    return columns | {f"tau{k}": tau[:, k] for k in range(3)}


def in_degrees(t, q, tau):
    columns = {"t": t, **{f"Joint{k + 1}Angle": np.rad2deg(q[:, k]) for k in range(3)}}
    return columns | {f"Joint{k + 1}Torque": tau[:, k] for k in range(3)}


def unit_of(mapping, key):
    return mapping["joints"][key]["unit"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "arm.urdf").write_text(arm_urdf(3))
    return tmp_path


def initialised(folder: Path, recording: Path, *more: str) -> int:
    """Run `fsw init`; later flags count."""
    flags = [*FLAGS.split(), *more, "--out", str(folder / "robot.yaml")]
    return main(["init", str(folder / "arm.urdf"), "--recording", str(recording), *flags])


def imported(folder: Path, recording: Path) -> int:
    words = ["--map", str(folder / "robot.map.yaml"), "--config", str(folder / "robot.yaml")]
    return main(["import", str(recording), *words, "--out", str(folder / "out.mcap")])


@pytest.mark.parametrize(
    ("columns", "time", "angle"),
    [(by_name, "s", "rad"), (by_number, "ms", "rad"), (in_degrees, "s", "deg")],
)
def test_a_table_is_imported_with_what_init_wrote(folder, columns, time, angle):
    recording = table(folder / "arm.csv", columns(*motion()))
    assert initialised(folder, recording) == 0
    assert main(["check", str(folder / "robot.yaml")]) == 0
    mapping = yaml.safe_load((folder / "robot.map.yaml").read_text())
    assert mapping["time"]["unit"] == time
    assert (unit_of(mapping, "position"), unit_of(mapping, "torque")) == (angle, "N m")
    config = load(folder / "robot.yaml")
    assert config.buses[0].rate_hz == pytest.approx(RATE_HZ, rel=0.01)
    for joint in config.joints:  # the noise of a known world, within a fifth
        assert joint.position_noise_rad == pytest.approx(NOISE_RAD, rel=0.2)
        assert joint.torque_noise_nm == pytest.approx(NOISE_NM, rel=0.2)
    assert imported(folder, recording) == 0
    assert "CHECK" in (folder / "robot.map.yaml").read_text()


def test_a_row_of_units_decides(folder):
    """Angles and rates are so small that they look like radians."""
    t, q, tau = motion()
    columns = by_name(1e3 * t, np.rad2deg(q) / 20.0, 1e3 * tau)
    columns |= {f"gyro_{axis}": 0.01 * q[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"acc_{axis}": q[:, k] for k, axis in enumerate("xyz")}
    lines = table(folder / "arm.csv", columns).read_text().splitlines()
    units = ",".join(["[ms]", *["[deg]"] * 3, *["[mNm]"] * 3, *["[deg/s]"] * 3, *["[g]"] * 3])
    (folder / "arm.csv").write_text("\n".join([lines[0], units, *lines[1:]]) + "\n")
    assert initialised(folder, folder / "arm.csv", *MOUNT.split()) == 0
    mapping = yaml.safe_load((folder / "robot.map.yaml").read_text())
    found = [unit_of(mapping, key) for key in ("position", "torque")]
    found += [mapping["imu"][key]["unit"] for key in ("rate", "specific_force")]
    assert [mapping["time"]["unit"], *found] == ["ms", "deg", "mN m", "deg/s", "g"]
    config = load(folder / "robot.yaml")
    assert config.joints[0].position_noise_rad == pytest.approx(NOISE_RAD / 20.0, rel=0.2)
    assert imported(folder, folder / "arm.csv") == 0


@pytest.mark.parametrize("rate_hz", [30.0, 1000.0])
def test_an_array_file_of_any_rate_is_imported(folder, rate_hz):
    t, q, tau = motion(rate_hz)
    np.savez(folder / "arm.npz", t=t, q=q, tau=tau, dq=q)
    assert initialised(folder, folder / "arm.npz") == 0
    assert main(["check", str(folder / "robot.yaml")]) == 0
    assert imported(folder, folder / "arm.npz") == 0


def test_an_inertial_unit_in_the_table_is_mapped(folder):
    t, q, tau = motion()
    rng = np.random.default_rng(4)
    columns = by_name(t, q, tau)
    columns |= {f"gyro_{axis}": 30.0 * rng.normal(size=len(t)) for axis in "xyz"}
    columns |= {f"acc_{axis}": 9.8 * (axis == "z") + 0.1 * t % 0.01 for axis in "xyz"}
    recording = table(folder / "arm.csv", columns)
    assert initialised(folder, recording, *MOUNT.split()) == 0
    mapping = yaml.safe_load((folder / "robot.map.yaml").read_text())
    assert mapping["imu"]["rate"] == {"columns": ["gyro_x", "gyro_y", "gyro_z"], "unit": "deg/s"}
    assert mapping["imu"]["specific_force"]["unit"] == "m/s2"
    assert load(folder / "robot.yaml").imu.driver == "samples"
    assert imported(folder, recording) == 0


@pytest.mark.parametrize("rate_hz", [5.0, 20.0, 50.0])
def test_windows_suit_an_inertial_unit_as_slow_as_the_joints(folder, rate_hz):
    """The window is the longer of both, also where both have one rate."""
    t, q, tau = motion(rate_hz)
    t, q, tau = (np.concatenate([x, x + k]) for x, k in ((t, np.ptp(t) + 1.0), (q, 0), (tau, 0)))
    columns = by_name(t, q, tau) | {f"{part}{a}": 0.1 * q[:, 0] for part in "wf" for a in "xyz"}
    recording = table(folder / "arm.csv", columns)
    assert initialised(folder, recording, *MOUNT.split()) == 0


def test_joints_without_torque_have_none(folder):
    t, q, tau = motion()
    columns = {name: own for name, own in by_name(t, q, tau).items() if "effort" not in name}
    assert initialised(folder, table(folder / "arm.csv", columns)) == 0
    assert {joint.torque for joint in load(folder / "robot.yaml").joints} == {"none"}


def test_currents_stand_for_torques_that_are_not_there(folder):
    t, q, tau = motion()
    currents = {f"current_{j}": tau[:, k] / 5.0 for k, j in enumerate(JOINTS)}
    planned = {f"target_current_{j}": 0.0 * t for j in JOINTS}
    angles = {name: own for name, own in by_name(t, q, tau).items() if "effort" not in name}
    recording = table(folder / "arm.csv", angles | planned | currents)
    assert initialised(folder, recording) == 0
    assert {own.torque for own in load(folder / "robot.yaml").joints} == {"motor_current"}
    assert "node_id" not in (folder / "robot.yaml").read_text(), "a table has no nodes"
    path = folder / "robot.map.yaml"
    (line,) = (own for own in path.read_text().splitlines() if own.startswith("  torque:"))
    assert "scale: [1.0, 1.0, 1.0]}  # CHECK N m per A at the joint, gear included" in line
    assert yaml.safe_load(path.read_text())["joints"]["torque"]["columns"] == list(currents)
    assert imported(folder, recording) == 0
    both = table(folder / "both.csv", by_name(t, q, tau) | currents)
    assert initialised(folder, both, "--force") == 0
    assert yaml.safe_load(path.read_text())["joints"]["torque"]["columns"][0] == "effort_axis1"


def test_a_can_log_gives_rate_and_nodes(folder):
    with can.Logger(folder / "arm.log") as logger:
        for k in range(400):
            for word, data in ((0x80, b"\x01"), *((0x180 + n, bytes(8)) for n in (5, 9, 7))):
                logger.on_message_received(
                    can.Message(
                        timestamp=1.7e9 + k / 100, arbitration_id=word, is_extended_id=False,
                        data=data, channel=0,
                    )
                )  # fmt: skip
    assert initialised(folder, folder / "arm.log", "--imu", "none") == 0
    config = load(folder / "robot.yaml")
    assert config.buses[0].rate_hz == pytest.approx(100.0, rel=0.01)
    assert [joint.node_id for joint in config.joints] == [5, 7, 9]
    assert not (folder / "robot.map.yaml").exists()
    words = ["--can", f"arm={folder / 'arm.log'}", "--config", str(folder / "robot.yaml")]
    assert main(["import", *words, "--out", str(folder / "out.mcap")]) == 0


LONG = {f"q{k}": np.linspace(0.0, 1.0, 99) for k in range(3)}


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"time": np.arange(99.0), "a": np.arange(99.0)}, "no 3 columns for the positions"),
        ({f"q{k}": np.arange(99.0) for k in range(3)}, "no column is named as a time"),
        (
            {"t": np.arange(9.0), **{name: own[:9] for name, own in LONG.items()}},
            "'t' has 9 rows; at least 51 are needed",
        ),
        ({"t": np.arange(99) // 25, **LONG}, "'t' has 4 different values in 99 rows; are these"),
        ({"t": np.arange(99) * 1e9, **LONG}, "'t' goes in steps of 1e+09; must be 0.0002 to 0.2 s"),
        ({"t": [f"{k}.11.2026 12:00" for k in range(99)], **LONG}, "'0.11.2026 12:00'; must be"),
        (
            {"t": np.arange(99.0), "q": np.zeros((3, 99))},
            "q 3 x 99 (a row is a sample: transposed?",
        ),
        ({"t": np.arange(99.0), "q": np.array([[None] * 3] * 99)}, "q (holds Python objects"),
    ],
)
def test_what_is_not_found_is_one_line(folder, columns, words, capsys):
    path = folder / ("arm.npz" if "q" in columns else "arm.csv")
    np.savez(path, **columns) if "q" in columns else table(path, columns)
    assert initialised(folder, path) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
    assert not (folder / "robot.yaml").exists()


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--base", "free"], "no columns of an inertial unit"),
        (["--imu", "stim300"], "--imu: stim300, and"),
        (["--tracker", "sagitta"], "--tracker: sagitta, and"),
    ],
)
def test_a_sensor_that_is_not_in_the_table_is_one_line(folder, flags, words, capsys):
    recording = table(folder / "arm.csv", by_name(*motion()))
    assert initialised(folder, recording, *flags) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line


def bag(path: Path, *, is_stamped: bool = True) -> Path:
    t, q, tau = motion(offset_s=0.0)
    joints = {"t": t} | {f"q_{name}": q[:, k] for k, name in enumerate(JOINTS)}
    joints |= {f"tau_{name}": tau[:, k] for k, name in enumerate(JOINTS)}
    unit = {"t": t} | {f"{part}{axis}": 0.1 * np.sin(t) for part in "wf" for axis in "xyz"}
    return write_bag(path, joints, unit, list(JOINTS), is_stamped=is_stamped)


@pytest.mark.parametrize(("is_stamped", "clock"), [(True, "stamp"), (False, "received")])
def test_a_bag_is_imported_with_what_init_wrote(folder, is_stamped, clock):
    bag(folder / "bag", is_stamped=is_stamped)
    assert initialised(folder, folder / "bag", *MOUNT.split()) == 0
    mapping = yaml.safe_load((folder / "robot.map.yaml").read_text())
    assert mapping["time"] == {"column": f"/joint_states.{clock}", "unit": "s"}
    assert mapping["imu"]["time"] == {"column": f"/imu.{clock}", "unit": "s"}
    assert mapping["imu"]["rate"]["columns"] == [f"/imu.angular_velocity.{a}" for a in "xyz"]
    assert imported(folder, folder / "bag") == 0


def with_a_spike(value):
    """Return damage to one angle and one torque."""

    def damage(t, q, tau):
        q[500, 1] = value
        tau[700, 2] = 1e4 * value
        return t, q, tau

    return damage


def without_some_times(t, q, tau):
    t[::10] = np.nan
    return t, q, tau


def with_other_rows_between(t, q, tau):
    """Every row is followed, 1 ms later, by one that holds nothing of the arm."""
    times = np.column_stack([t, t + 1e-3]).ravel()
    return times, *(np.stack([own, own * np.nan], axis=1).reshape(-1, 3) for own in (q, tau))


def in_disorder(t, q, tau):
    swapped = np.arange(len(t)) ^ 1
    return t[swapped], q[swapped], tau[swapped]


@pytest.mark.parametrize(
    "damage",
    [
        *[with_a_spike(value) for value in (100.0, np.inf, -1e30)],
        *[without_some_times, with_other_rows_between, in_disorder],
    ],
    ids=["spike", "infinity", "huge", "no times", "other rows", "disorder"],
)
def test_faults_of_single_rows_decide_nothing(folder, damage):
    """Unit, rate, limits and noise are those of the rows that can be used."""
    recording = table(folder / "arm.csv", by_name(*damage(*motion())))
    assert initialised(folder, recording, "--imu", "none") == 0
    config = load(folder / "robot.yaml")
    mapping = yaml.safe_load((folder / "robot.map.yaml").read_text())
    assert unit_of(mapping, "position") == "rad"
    assert config.buses[0].rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    for joint in config.joints:
        assert joint.speed_limit_rad_s <= 3.0
        assert joint.torque_limit_nm <= 60.0
        assert joint.position_noise_rad == pytest.approx(NOISE_RAD, rel=0.3)
        assert joint.torque_noise_nm == pytest.approx(NOISE_NM, rel=0.3)
    assert imported(folder, recording) == 0


def test_a_name_of_two_words_is_one_name(folder, capsys):
    urdf = folder / "arm.urdf"
    urdf.write_text(urdf.read_text().replace('"axis1"', '"first axis"'))
    columns = {name.replace("axis1", "first axis"): x for name, x in by_name(*motion()).items()}
    recording = table(folder / "arm.csv", columns)
    assert initialised(folder, recording, "--imu", "none") == 0
    assert imported(folder, recording) == 0
    main(["check", str(folder / "robot.yaml"), str(folder / "out.mcap")])
    assert "another robot" not in capsys.readouterr().err


def test_a_mapping_is_not_overwritten(folder, capsys):
    recording = table(folder / "arm.csv", by_name(*motion()))
    (folder / "robot.map.yaml").write_text("mine")
    assert initialised(folder, recording) == 2
    assert "exists; --force overwrites it" in capsys.readouterr().err
    assert (folder / "robot.map.yaml").read_text() == "mine"
    assert not (folder / "robot.yaml").exists()
