"""The schema: what it refuses, and that every message names key, value and bound."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from fsw.checks.configuration import missing_devices, validate, validate_ports
from fsw.config import load, parse
from fsw.config.tables import NoiseTable
from fsw.config.telemetry import STATE_FOLDERS
from fsw.errors import ConfigError


def fault(arm: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        load(arm.write())
    return str(caught.value)


def set_key(data: Any, key: str, value: object) -> None:
    """Set one dotted key of nested mappings and lists."""
    *path, last = [int(part) if part.isdigit() else part for part in key.split(".")]
    for part in path:
        data = data[part]
    data[last] = value


def test_the_arm_of_these_tests_is_correct(arm):
    config = load(arm.write())
    assert [joint.node_id for joint in config.joints] == [0x11, 0x12, 0x13]
    assert config.resolve(config.robot.urdf) == arm.folder / "arm.urdf"
    assert config.name == str(arm.folder / "config.yaml")


# key to spoil, value, words of the message: the key, the value, the bound
SPOILED = [
    (
        "joints.1.torque_noise_nm",
        -0.05,
        ("joints.1.torque_noise_nm", "-0.05", "at least"),
    ),
    (
        "joints.0.position_noise_rad",
        0.0,
        ("joints.0.position_noise_rad", "0.0", "at least"),
    ),
    ("joints.0.torque_limit_nm", -1, ("joints.0.torque_limit_nm", "-1", "above 0")),
    ("joints.0.speed_limit_rad_s", 0, ("joints.0.speed_limit_rad_s", "0", "above 0")),
    ("joints.0.torque_offset_sigma_nm", -0.1, ("torque_offset_sigma_nm", "-0.1", "at least 0")),
    ("joints.0.node_id", 128, ("joints.0.node_id", "128", "at most 127")),
    ("joints.0.sign", 2, ("joints.0.sign", "2", "-1 or 1")),
    ("joints.0.format", "fd", ("joints.0.format", "fd", "buses.arm.fd: true")),
    ("joints.0.bus", "leg", ("joints.0.bus", "leg", "['arm']")),
    ("joints.1.node_id", 0x11, ("joints.node_id", "arm:0x11", "unique")),
    ("joints.1.name", "axis1", ("joints.name", "axis1", "unique")),
    ("joints.0.driver", "ethercat", ("joints.0.driver", "ethercat", "canopen")),
    ("joints", [], ("joints", "missing", "reaction wheels")),
    ("buses.0.rate_hz", 300.0, ("buses.0.rate_hz", "300", "divide scheduler.tick_rate_hz 500")),
    ("buses.0.rate_hz", 1000.0, ("buses.0.rate_hz", "1000", "divide scheduler.tick_rate_hz 500")),
    ("buses.0.name", "a/b", ("buses.0.name", "a/b", "letters, digits and the signs in")),
    ("buses.0.sync_counter_max", 241, ("buses.0.sync_counter_max", "241", "240")),
    ("buses.0.sync", "both", ("buses.0.sync", "both", "'producer', 'consumer' or 'none'")),
    ("imu.rate_hz", "fast", ("imu.rate_hz", "fast", "number")),
    ("imu.acc_range_g", 20, ("imu.acc_range_g", "20", "5, 10, 30 or 80")),
    ("imu.mounting.q_BS_xyzw", [0, 0, 0, 2], ("q_BS_xyzw", "[0.0, 0.0, 0.0, 2.0]", "norm 2")),
    ("imu.mounting.p_BS_m", [0, 0], ("imu.mounting.p_BS_m: entry 3 is missing", "[0, 0]")),
    (
        "imu.angle_random_walk_rad_sqrt_s",
        -1e-5,
        ("imu.angle_random_walk", "-1e-05", "at least"),
    ),
    ("imu.gyro_group_delay_s", -0.001, ("imu.gyro_group_delay_s", "-0.001", "at least 0")),
    ("star_tracker.latency_s", -0.1, ("star_tracker.latency_s", "-0.1", "at least 0")),
    ("star_tracker.time", "gps", ("star_tracker.time", "gps", "'unit' or 'arrival'")),
    ("star_tracker.rotation", "left", ("star_tracker.rotation", "left", "inertial_to_tracker")),
    ("star_tracker.port", "/dev/serial/imu", ("imu.port and star_tracker.port", "one device only")),
    ("scheduler.tick_rate_hz", 0, ("scheduler.tick_rate_hz", "0", "above 0")),
    ("scheduler.realtime_priority", 100, ("realtime_priority", "100", "at most 99")),
    ("unknown", [], ("unknown", "0 entries", "at least 1")),
    ("unknown", ["arm"], ("bodies.arm", "missing")),
    ("unknown", ["An Arm"], ("unknown.0", "An Arm", "letters, digits and the signs in")),
    ("bodies.target.frame", "gripper", ("bodies.target.frame", "left out")),
    (
        "bodies.box",
        {"mass_kg": 1.0, "com_m": [0, 0, 0], "inertia_kg_m2": [1, 0, 0, 1, 0, 1]},
        ("bodies.box.frame", "missing"),
    ),
    ("unknown", ["target", "target"], ("unknown", "target", "unique")),
    ("unknown", ["base", "target"], ("bodies.base", "missing", "needs a prior")),
    ("bodies.target.sigma", None, ("bodies.target.sigma", "missing")),
    ("bodies.target.mass_kg", 1e-6, ("bodies.target.mass_kg", "1e-06", "0.001")),
    ("bodies.target.com_m", [70000, 0, 0], ("bodies.target.com_m.0", "70000", "100")),
    ("bodies.target.sigma.mass_kg", 1e10, ("bodies.target.sigma.mass_kg", "1000000")),
    ("joints.0.torque_noise_nm", 1e155, ("joints.0.torque_noise_nm", "1e+155", "10000")),
    ("bodies.target.mass_kg", -80, ("bodies.target.mass_kg", "-80", "at least")),
    ("bodies.target.sigma.mass_kg", 0, ("bodies.target.sigma.mass_kg", "0", "at least")),
    (
        "bodies.target.inertia_kg_m2",
        [1, 0, 0, 1, 0, 9],
        ("bodies.target", "[1.0, 0.0, 0.0, 1.0, 0.0, 9.0]", "sum of the other two"),
    ),
    ("recorder.compression", "zip", ("recorder.compression", "zip", "'zstd', 'lz4' or 'none'")),
    ("robot.tool_frame", None, ("robot.tool_frame", "null", "text")),
    ("imu.mounting.rpy_BS_rad", [0, 0, 0], ("rpy_BS_rad", "q_BS_xyzw", "one of the two")),
]


@pytest.mark.parametrize(
    ("key", "value", "words"), SPOILED, ids=[f"{key}={value}" for key, value, _ in SPOILED]
)
def test_a_wrong_value_is_named_with_its_bound(arm, key, value, words):
    set_key(arm.data, key, value)
    message = fault(arm)
    assert [word for word in words if word not in message] == []
    assert message.startswith(str(arm.folder / "config.yaml") + ": ")
    assert len(message.splitlines()) == 1, message


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_not_finite_numbers_are_refused(arm, value):
    arm.data["imu"]["gyro_group_delay_s"] = value
    assert "imu.gyro_group_delay_s" in fault(arm)


def test_an_unknown_key_shows_the_choices_and_the_closest(arm):
    arm.data["joints"][2]["torque_noise"] = 0.1
    message = fault(arm)
    assert "joints.2.torque_noise: unknown key (value: 0.1)" in message
    assert "did you mean 'torque_noise_nm'?" in message
    assert "speed_limit_rad_s" in message


def test_an_unknown_key_below_a_body_shows_the_choices_of_the_body(arm):
    arm.data["bodies"]["target"]["sigma"]["mass"] = 1.0
    assert "allowed here: com_m, inertia_kg_m2, mass_kg" in fault(arm)


def test_every_fault_is_told_at_once(arm):
    arm.data["imu"]["rate_hz"] = -1
    del arm.data["scheduler"]
    message = fault(arm)
    assert "imu.rate_hz" in message
    assert "scheduler: missing" in message


def test_a_key_written_twice_is_refused(arm):
    path = arm.write()
    path.write_text(path.read_text() + "unknown: [base]\n")
    with pytest.raises(ConfigError, match="'unknown' stands twice"):
        load(path)


def test_two_buses_on_one_channel_are_refused(arm):
    arm.data["buses"].append({**arm.data["buses"][0], "name": "other"})
    assert "buses.0.channel and buses.1.channel: all name 'virtual:arm'" in fault(arm)


def test_an_absent_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"nothing.yaml: cannot be read: No such file"):
        load(tmp_path / "nothing.yaml")


NO_CONFIGURATION = [
    b"",
    b"[1, 2]",
    b"just words",
    b"a: [1",
    b"\xff\xfe\x00",
    b"? [a]",
    b"a: 2000-99-99",
]


@pytest.mark.parametrize("text", NO_CONFIGURATION)
def test_text_that_is_no_configuration_is_one_clear_error(text):
    with pytest.raises(ConfigError, match=r"^name: "):
        parse(text, Path(), "name")


@given(st.text(max_size=60))
def test_arbitrary_text_never_raises_anything_else(text):
    with pytest.raises(ConfigError):
        parse(text.encode("utf-8", "surrogatepass"), Path(), "name")


def test_a_number_written_without_its_point_is_a_number(arm):
    path = arm.write()
    text = path.read_text().replace("position_noise_rad: 1.0e-05", "position_noise_rad: 1e-5")
    path.write_text(text)
    assert "1e-5" in text
    assert load(path).joints[0].position_noise_rad == 1e-5


@pytest.mark.parametrize("name", ["/", "..", ".", "", "a/../../b", "/etc", "a b", "x" * 65])
def test_the_file_directory_is_one_folder_of_the_state_directory(arm, name):
    arm.data["telemetry"] = {"file_directory": name}
    assert "telemetry.file_directory" in fault(arm)


@pytest.mark.parametrize("name", STATE_FOLDERS)
def test_the_file_directory_is_none_that_holds_the_daemons_state(arm, name):
    arm.data["telemetry"] = {"file_directory": name}
    assert f"{name!r} is a folder of the daemon's own state" in fault(arm)


def test_a_mounting_may_be_given_by_angles_as_in_a_urdf(arm):
    angles = [0.3, -1.1, 2.0]
    mounting = arm.data["imu"]["mounting"]
    del mounting["q_BS_xyzw"]
    mounting["rpy_BS_rad"] = angles
    config = load(arm.write())
    expected = Rotation.from_euler("xyz", angles).as_quat()
    found = np.array(config.imu.mounting.q_BS_xyzw)
    assert abs(found @ expected) == pytest.approx(1.0, abs=1e-14)
    assert config.with_unknown(("target",)).imu == config.imu


@pytest.mark.parametrize("angles", [[0.1, 0.2], "level", [0.0, 0.0, float("nan")]])
def test_angles_that_are_none_are_named(arm, angles):
    mounting = arm.data["imu"]["mounting"]
    del mounting["q_BS_xyzw"]
    mounting["rpy_BS_rad"] = angles
    message = fault(arm)
    assert "rpy_BS_rad" in message
    assert "three finite numbers" in message


def test_a_replay_needs_neither_ports_nor_a_place_for_state(arm):
    for section in ("imu", "star_tracker"):
        del arm.data[section]["port"]
    del arm.data["buses"][0]["interface"], arm.data["buses"][0]["channel"]
    del arm.data["service"]
    config = load(arm.write())
    validate(config)
    with pytest.raises(ConfigError) as caught:
        validate_ports(config)
    keys = ("imu.port", "star_tracker.port", "buses.0.interface", "buses.0.channel")
    assert [key for key in keys if f"{key}: missing" not in str(caught.value)] == []
    assert len(missing_devices(config)) == len(keys)


def test_a_table_cannot_bring_friction_into_the_state_in_flight() -> None:
    """It would change the shape of estimates and checkpoints under a running process."""
    with pytest.raises(ValidationError, match="friction_coulomb_sigma_nm"):
        NoiseTable.model_validate({"joints": {"axis1": {"friction_coulomb_sigma_nm": 0.3}}})
