"""Whatever `fsw init` writes, `fsw check` accepts; what cannot be is one line, and no file."""

import io
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fsw.__main__ import main
from fsw.checks import budget, configuration
from fsw.checks.configuration import HIGH_LOAD
from fsw.config import load
from offline import check
from tests.conftest import arm_urdf

UNITS = ("stim300", "3dm_cv7", "vn_100")
IMU = "--imu-xyz 0.1 0 0 --imu-rpy 0 0 1"


def made(folder: Path, urdf: str, flags: str) -> tuple[int, list[str]]:
    """Return the exit code of `fsw init`, and what it said on stderr."""
    (folder / "arm.urdf").write_text(urdf)
    out, error = str(folder / "robot.yaml"), io.StringIO()
    words = ["init", str(folder / "arm.urdf"), "--out", out, "--tool", "gripper", *flags.split()]
    with redirect_stderr(error), redirect_stdout(io.StringIO()):
        code = main(words)
    return code, error.getvalue().splitlines()


@settings(max_examples=10)
@given(
    joints=st.integers(1, 8),
    rate_hz=st.one_of(st.floats(20.0, 2000.0), st.sampled_from([20, 30, 250, 1000, 2000])),
    kind=st.sampled_from(["revolute", "continuous", "prismatic"]),
    unknown=st.sampled_from(["base", "target", "both"]),
    base=st.sampled_from(["free", "planar", "clamped"]),
    imu=st.sampled_from(["none", *UNITS]),
    tracker=st.booleans(),
    mass_kg=st.floats(0.01, 1e5),
    effort=st.sampled_from(["50", "0", "1e16", "1e-6", "90000"]),
)
@example(1, 20.0, "prismatic", "both", "free", "stim300", True, 2.0, "1e16")
def test_what_is_written_is_accepted(
    joints, rate_hz, kind, unknown, base, imu, tracker, mass_kg, effort
):
    flags = f"--unknown {unknown} --base {base} --imu {imu} --rate-hz {rate_hz} "
    flags += f"--target-mass-kg {mass_kg} " + (IMU if imu != "none" else "")
    flags += " --tracker " + ("sagitta --tracker-rpy 0 0 0" if tracker else "none")
    urdf = arm_urdf(joints, joint_type=kind).replace('effort="50"', f'effort="{effort}"')
    with TemporaryDirectory() as name:
        folder = Path(name)
        code, said = made(folder, urdf, flags)
        is_possible = (imu != "none" or base == "clamped") and (
            unknown == "target" or base != "clamped"
        )
        assert code == (0 if is_possible else 2), said
        if code == 2:
            assert len(said) == 1
            assert not (folder / "robot.yaml").exists()
            return
        out = io.StringIO()
        with redirect_stderr(out), redirect_stdout(out):
            assert main(["check", str(folder / "robot.yaml")]) == 0, out.getvalue()


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ("--rate-hz 5000", "--rate-hz: 5000 is more than a bus"),
        ("--first-node 0x7f", "--first-node: 0x7f and 3 joints end at node 129"),
        ("--first-node 0", "--first-node: 0x00"),
    ],
)
def test_what_no_bus_can_have_is_one_line(tmp_path, flags, words):
    usual = "--unknown target --base clamped --imu none --tracker none --target-mass-kg 2 "
    code, said = made(tmp_path, arm_urdf(3), usual + flags)
    assert code == 2
    assert len(said) == 1
    assert words in said[0]


@pytest.mark.parametrize("rate_hz", [20, 250, 1000, 2000])
@pytest.mark.parametrize("joints", [1, 13, 30, 40])
def test_many_joints_are_spread_over_buses(tmp_path, monkeypatch, joints, rate_hz):
    # the dry update of 40 joints takes a minute, the costs of effects seconds: one rate has these
    monkeypatch.setattr(configuration, "rehearse", lambda *_: None)
    if rate_hz != 20:
        monkeypatch.setattr(check, "told", lambda *_: [])
    usual = f"--unknown target --base clamped --imu none --tracker none --rate-hz {rate_hz}"
    assert made(tmp_path, arm_urdf(joints), f"{usual} --target-mass-kg 2")[0] == 0
    assert main(["check", str(tmp_path / "robot.yaml")]) == 0
    config = load(tmp_path / "robot.yaml")
    assert {joint.bus for joint in config.joints} == {bus.name for bus in config.buses}
    assert max(budget.bus_load(config, bus) for bus in config.buses) <= HIGH_LOAD
    assert len({joint.node_id for joint in config.joints}) == joints
