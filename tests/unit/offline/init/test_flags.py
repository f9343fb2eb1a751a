"""Flags of `fsw init` that cannot be, and URDFs with names that YAML reads as something else."""

import re
from pathlib import Path

import pytest

from fsw.__main__ import main
from fsw.config import load
from tests.conftest import arm_urdf

FLAGS = (
    "--tool gripper --unknown target --imu stim300 --imu-xyz 0 0 0 --imu-rpy 0 0 0 --tracker none"
)


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(arm_urdf(3))
    return path


def made(urdf: Path, *more: str, mass: str = "10") -> int:
    out = () if "--out" in more else ("--out", str(urdf.with_name("robot.yaml")))
    return main(["init", str(urdf), *FLAGS.split(), "--target-mass-kg", mass, *out, *more])


@pytest.mark.parametrize("mass", ["-5", "0", "nan", "inf", "1e30"])
def test_a_mass_that_cannot_be_is_one_line_about_its_flag(urdf, capsys, mass):
    assert made(urdf, mass=mass) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert "--target-mass-kg" in said[0]
    assert not urdf.with_name("robot.yaml").exists()


@pytest.mark.parametrize("name", ["1", "on", "a: b", "%s", "yes", "0x21"])
def test_a_joint_keeps_a_name_that_yaml_would_read_otherwise(urdf, name):
    urdf.write_text(urdf.read_text().replace('"axis2"', f'"{name}"'))
    assert made(urdf) == 0
    assert load(urdf.with_name("robot.yaml")).joints[1].name == name


def test_nodes_are_counted_from_the_first(urdf):
    assert made(urdf, "--first-node", "0x21") == 0
    joints = load(urdf.with_name("robot.yaml")).joints
    assert [joint.node_id for joint in joints] == [0x21, 0x22, 0x23]


@pytest.mark.parametrize("out", [".", "nowhere/robot.yaml", "/dev/full", "arm.urdf"])
def test_a_place_that_cannot_be_written_is_one_line(urdf, out, capsys, monkeypatch):
    monkeypatch.chdir(urdf.parent)
    before = urdf.read_text()
    assert made(urdf, "--out", out, "--force") == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert urdf.read_text() == before


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<limit", '<mimic joint="axis1"/><limit', "mimics another"),
        ("revolute", "fixed", "no joint that moves"),
        ('<mass value="', '<mass value="-', "mass"),
    ],
)
def test_a_robot_that_cannot_be_is_refused(urdf, capsys, old, new, words):
    urdf.write_text(urdf.read_text().replace(old, new))
    assert made(urdf) == 2
    assert words in capsys.readouterr().err


CLAMPED = "--tool gripper --imu none --tracker none --base clamped --target-mass-kg 2"
MASSLESS = re.compile(r"<inertial>.*?</inertial>")


def written(urdf: Path, *more: str) -> int:
    return main(
        ["init", str(urdf), *CLAMPED.split(), "--out", str(urdf.with_name("robot.yaml")), *more]
    )


def test_a_massless_root_is_accepted_on_a_clamped_base(urdf, capsys):
    urdf.write_text(MASSLESS.sub("", urdf.read_text(), count=1))
    assert written(urdf, "--unknown", "target") == 0
    assert main(["check", str(urdf.with_name("robot.yaml"))]) == 0
    assert "has no mass" not in capsys.readouterr().out


@pytest.mark.parametrize("unknown", ["base", "both"])
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('<mass value="200"/>', '<mass value="0"/>', "the root link 'bus' has no mass"),
        (MASSLESS.search(arm_urdf(1)).group(), "", "the root link 'bus' has no mass"),
        ('izz="40"', 'izz="4000"', "an inertia that no body can have"),
    ],
)
def test_a_root_that_gives_no_prior_is_one_line(urdf, capsys, unknown, old, new, words):
    urdf.write_text(urdf.read_text().replace(old, new, 1))
    assert written(urdf, "--unknown", unknown) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
    assert not urdf.with_name("robot.yaml").exists()


@pytest.mark.parametrize(
    ("limit", "marked"),
    [
        ('<limit lower="-3" upper="3" effort="0" velocity="0"/>', 6),
        ('<limit lower="-3" upper="3" effort="1e16" velocity="0.5"/>', 3),
        ('<limit effort="50" velocity="0.5"/>', 0),
        ("", 6),
    ],
)
def test_a_placeholder_of_a_limit_is_marked(urdf, limit, marked):
    text = urdf.read_text().replace("revolute", "continuous")
    urdf.write_text(re.sub("<limit[^>]*>", limit, text))
    assert written(urdf, "--unknown", "target") == 0
    lines = urdf.with_name("robot.yaml").read_text().splitlines()
    assert sum("_limit_" in line and "CHECK" in line for line in lines) == marked
    assert main(["check", str(urdf.with_name("robot.yaml"))]) == 0


def test_the_link_of_a_name_is_the_tool_beside_its_joint(urdf):
    """Links and joints have separate name spaces, as in the robots of Rethink."""
    urdf.write_text(urdf.read_text().replace('joint name="mount"', 'joint name="gripper"'))
    assert written(urdf, "--unknown", "target") == 0
    assert main(["check", str(urdf.with_name("robot.yaml"))]) == 0
