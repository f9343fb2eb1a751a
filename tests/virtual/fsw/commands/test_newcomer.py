"""Mistakes of a newcomer: each is one line that says what is wrong and what to do."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from fsw.__main__ import main
from hil.run.bench import prepare, run_virtual
from tests.conftest import ArmProject
from tests.support.short_cases import NoMeter, short

LINK2 = (
    '<link name="link2"><inertial><origin xyz="0 0 0.2"/><mass value="3"/>'
    '<inertia ixx="0.04" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.01"/></inertial></link>'
)


def prismatic(arm):
    arm.robot(3, "prismatic")
    return "joint 'axis1' is 'prismatic'; must be revolute or fixed"


def continuous(arm):
    arm.robot(3, "continuous")
    return "'continuous'; must be revolute or fixed; write it as revolute with wide limits"


def fixed_base(arm):
    hinge = (
        '<link name="world"/><joint name="w" type="revolute"><parent link="world"/>'
        '<child link="bus"/><limit lower="0" upper="0" effort="1" velocity="1"/></joint>'
    )
    arm.urdf = arm.urdf.replace('<robot name="arm">', f'<robot name="arm">{hinge}')
    return "the root link has mass 0 kg; must be positive, or bodies.base given"


def millimetres(arm):
    arm.urdf = arm.urdf.replace('xyz="0 0 0.4"', 'xyz="0 0 400"')
    return "xyz '400' in <origin>; must be finite and within 100 (metres"


def xacro(arm):
    space = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
    arm.urdf = f'<robot name="a" {space}><xacro:include filename="a"/></robot>'
    return "is a xacro file, no URDF yet; make one: xacro robot.xacro > robot.urdf"


def degrees(arm):
    arm.data["joints"][0]["zero_offset_rad"] = 90.0
    return "joints.0.zero_offset_rad: input should be less than or equal to"


def one_node_twice(arm):
    arm.data["joints"][1]["node_id"] = 0x11
    return "joints.node_id: 'arm:17' is used 2 times; must be unique"


def other_names(arm):
    arm.data["joints"][0]["name"] = "joint1"
    return "must be the 3 joints of the robot ['axis1', 'axis2', 'axis3']"


def misspelt_key(arm):
    arm.data["imu"]["gyro_bias_sigma"] = 1e-5
    return "imu.gyro_bias_sigma: unknown key (value: 1e-05); did you mean 'gyro_bias_sigma_rad_s'?"


def slow_bus(arm):
    arm.data["buses"][0]["bitrate"] = 125_000
    return "loads 'arm' to 102% at buses.bitrate 125000; must be at most 100%"


def quaternion_not_unit(arm):
    arm.data["imu"]["mounting"]["q_BS_xyzw"] = [0.0, 0.0, 0.7, 0.7]
    return "must be 1 within 1e-6"


def tool_not_there(arm):
    arm.data["robot"]["tool_frame"] = "hand"
    return "'hand' is no frame of arm.urdf; it has"


FAULTS = [
    prismatic,
    continuous,
    fixed_base,
    millimetres,
    xacro,
    degrees,
    one_node_twice,
    other_names,
    misspelt_key,
    slow_bus,
    quaternion_not_unit,
    tool_not_there,
]


@pytest.mark.parametrize("spoil", FAULTS)
def test_a_wrong_description_is_one_line(arm, capsys, spoil):
    words = spoil(arm)
    assert main(["check", str(arm.write())]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line


def test_a_tab_in_yaml_is_one_line(arm, capsys):
    path = arm.write()
    path.write_text("robot:\n\turdf: arm.urdf\n")
    assert main(["check", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "found character '\\t' that cannot start any token" in line
    assert "line 2" in line


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (LINK2, '<link name="link2"/>', "the link moved by 'axis2' has no mass; is its <inertial>"),
        ('xyz="0 0 0.4"', 'xyz="0 0 40"', "is 40 m from the one before it; a URDF is in metres"),
    ],
)
def test_data_that_hardly_are_a_robots_are_warned_of(arm, capsys, old, new, words):
    assert old in arm.urdf
    arm.urdf = arm.urdf.replace(old, new, 1)
    main(["check", str(arm.write())])
    warned = [line for line in capsys.readouterr().out.splitlines() if "warning: robot" in line]
    assert any(words in line for line in warned)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a short motion in virtual time: its configuration and recording."""
    folder = tmp_path_factory.mktemp("flown")
    run_virtual(prepare(short(folder, hurry=2.0), 1, folder), NoMeter(), record=True)
    return folder


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"", "not an MCAP recording: it is empty"), (b"t,q1\n0,1\n", "not an MCAP recording")],
)
def test_a_file_that_is_no_recording_is_one_line(arm, capsys, content, words):
    path = arm.folder / "file.mcap"
    path.write_bytes(content)
    assert main(["replay", str(path), "--config", str(arm.write())]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line


def test_a_truncated_recording_is_used_as_far_as_it_goes(flown, tmp_path, capsys):
    whole = (flown / "recording.mcap").read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[: len(whole) // 2])
    config = str(flown / "flight.yaml")
    for command in (["replay", str(path), "--config", config], ["check", config, str(path)]):
        main(command)
        said = capsys.readouterr()
        assert "is cut off at its end" in said.out + said.err
    main(["identify", str(path), "--config", config])
    assert "is cut off at its end" in capsys.readouterr().out


def test_the_recording_of_another_robot_is_named_by_its_nodes(flown, tmp_path, capsys):
    arm = ArmProject(tmp_path)
    assert main(["check", str(arm.write()), str(flown / "recording.mcap")]) == 1
    line = capsys.readouterr().out.splitlines()[0]
    assert "arm: nodes 0x14, 0x15, 0x16, 0x17 send and are no nodes of the configuration" in line
    assert "is the recording that of another robot?" in line


def test_the_recording_of_another_bus_names_both(flown, tmp_path, capsys):
    data = yaml.safe_load((flown / "flight.yaml").read_text())
    data["robot"]["urdf"] = str(flown / data["robot"]["urdf"])
    data["buses"][0]["name"] = "leg"
    for joint in data["joints"]:
        joint["bus"] = "leg"
    path = tmp_path / "leg.yaml"
    path.write_text(yaml.safe_dump(data))
    assert main(["replay", str(flown / "recording.mcap"), "--config", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no channel /can/leg" in line
    assert "found: /can/arm" in line
