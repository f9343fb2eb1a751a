"""A configuration for a robot of one's own, written by `fsw init`."""

import pytest

from fsw.__main__ import main
from fsw.config import load
from offline.init.command import library

FLAGS = {
    "--tool": "gripper",
    "--unknown": "both",
    "--target-mass-kg": "80",
    "--imu": "stim300",
    "--imu-xyz": "0.1 0 0",
    "--imu-rpy": "0 0 1.5",
    "--tracker": "sagitta",
    "--tracker-rpy": "0 0 0",
}


def command(arm, **changes):
    arm.write()
    flags = FLAGS | {f"--{key.replace('_', '-')}": value for key, value in changes.items()}
    words = [word for flag, value in flags.items() if value for word in (flag, *value.split())]
    return ["init", str(arm.folder / "arm.urdf"), "--out", str(arm.folder / "new.yaml"), *words]


@pytest.mark.parametrize("imu", list(library()["imu"]))
def test_what_is_written_is_correct_for_every_named_unit(arm, capsys, imu):
    assert main(command(arm, imu=imu)) == 0
    assert main(["check", str(arm.folder / "new.yaml")]) == 0
    config = load(arm.folder / "new.yaml")
    figures = library()["imu"][imu]
    assert config.imu.angle_random_walk_rad_sqrt_s == figures["angle_random_walk_rad_sqrt_s"]
    text = (arm.folder / "new.yaml").read_text()
    assert figures["source"] in text
    assert ("NOT VERIFIED" in text.split("imu:")[0].splitlines()[-1]) != figures["verified"]
    assert "# CHECK" in text
    capsys.readouterr()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"imu": "stim30"}, ("stim30", "did you mean stim300?")),
        ({"imu": None}, ("--imu: missing", "stim300")),
        ({"tool": "hand"}, ("--tool", "hand", "gripper")),
        ({"tool": None}, ("--tool: missing", "gripper")),
        ({"target_mass_kg": None}, ("--target-mass-kg: missing", "[kg]")),
    ],
)
def test_what_is_missing_or_wrong_is_one_line(arm, capsys, changes, words):
    assert main(command(arm, **changes)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert [word for word in words if word not in line] == []
    assert not (arm.folder / "new.yaml").exists()


def test_all_that_is_missing_is_named_at_once(arm, capsys):
    flags = dict.fromkeys((flag[2:].replace("-", "_") for flag in FLAGS), None)
    assert main(command(arm, **flags)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    first, *others = [flag for flag in FLAGS if flag != "--tracker-rpy"]  # the default has none
    assert f"{first}: missing; " in line
    assert line.endswith(f"(missing too: {', '.join(others)})")


def test_a_file_is_not_overwritten(arm, capsys):
    assert main(command(arm)) == 0
    assert main(command(arm)) == 2
    assert "exists; --force overwrites it" in capsys.readouterr().err


def test_a_wrong_answer_is_asked_again_with_its_bound(arm, capsys, monkeypatch):
    flags = dict.fromkeys((flag[2:].replace("-", "_") for flag in FLAGS), None)
    answers = ["hand", "gripper", "arm", "target", "45 kg", "-3", "45", "stim30", "stim300"]
    answers += ["0 0", "0 0 0", "0 0 90", "0 0 1.5", "none"]
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda _words: answers.pop(0))
    assert main(command(arm, **flags)) == 0
    said = capsys.readouterr().err.splitlines()
    bounds = ("must be one of", "base, target, both", "45 kg", "must be positive")
    bounds += ("stim300", "must be three numbers", "must be radians, each at most 6.28319")
    assert [bound in line for bound, line in zip(bounds, said, strict=True)] == [True] * len(said)
    assert load(arm.folder / "new.yaml").bodies["target"].mass_kg == 45.0


def test_every_device_is_listed_with_its_source(capsys):
    assert main(["init", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == sum(map(len, library().values()))


@pytest.mark.parametrize("held", ["free", "clamped"])
def test_a_root_fixed_to_the_world_must_be_explained(arm, capsys, held):
    world = (
        '<link name="world"/><joint name="w" type="fixed"><parent link="world"/>'
        '<child link="bus"/></joint>'
    )
    arm.urdf = arm.urdf.replace('<robot name="arm">', f'<robot name="arm">{world}')
    assert main(command(arm, unknown="target")) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert (
        "--base: missing; the root link 'world' has no mass and a fixed joint; what holds" in line
    )
    assert main(command(arm, unknown="target", base=held)) == 0
    config = load(arm.folder / "new.yaml")
    assert config.base.motion == held
    assert config.base.gravity_B_m_s2 == ((0, 0, 0) if held == "free" else (0, 0, -9.80665))


def test_a_clamped_base_needs_no_inertial_unit(arm):
    without = {
        "imu": "none",
        "imu_xyz": None,
        "imu_rpy": None,
        "tracker": "none",
        "tracker_rpy": None,
    }
    assert main(command(arm, unknown="target", base="clamped", **without)) == 0
    assert not load(arm.folder / "new.yaml").imu.present
