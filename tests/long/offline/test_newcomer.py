"""Mistakes of a newcomer, each row of docs/howto/when_wrong.md: made here, and looked up."""

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from fsw.__main__ import main
from fsw.checks import configuration
from tests.conftest import ArmProject
from tests.support import first_mistakes
from tests.support.rewritten import rewritten
from tests.support.sampled_mistakes import IN_FREE_FLOAT, UNDER_GRAVITY
from tests.support.when_wrong import PAGE, ROWS

SAMPLED = {*UNDER_GRAVITY, *IN_FREE_FLOAT}  # made in test_check_samples.py
FIRST = set(first_mistakes.MADE)  # made in test_first_mistakes.py
WORLD = (
    '<link name="world"/><joint name="w" type="fixed"><parent link="world"/>'
    '<child link="bus"/></joint>'
)
LINK2 = (
    '<link name="link2"><inertial><origin xyz="0 0 0.2"/><mass value="3"/>'
    '<inertia ixx="0.04" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.01"/></inertial></link>'
)


def replaced(arm: ArmProject, old: str, new: str) -> None:
    assert old in arm.urdf
    arm.urdf = arm.urdf.replace(old, new, 1)


def channel(arm: ArmProject) -> None:
    arm.data["buses"][0] |= {"interface": "socketcan", "channel": "can77"}


def down(arm: ArmProject, monkeypatch: pytest.MonkeyPatch) -> None:
    link = arm.folder / "net" / "can77"
    link.mkdir(parents=True)
    (link / "flags").write_text("0x1002\n")  # as of a link that is down
    monkeypatch.setattr(configuration, "LINKS", link.parent)
    channel(arm)


def forbidden(arm: ArmProject, monkeypatch: pytest.MonkeyPatch) -> None:
    access = os.access  # root may use every port
    monkeypatch.setattr(os, "access", lambda p, m: str(p) != "/dev/null" and access(p, m))
    arm.data["imu"]["port"] = "/dev/null"


def twice(arm: ArmProject, _: object) -> None:
    arm.data["joints"][1]["node_id"] = 0x11


def set_joint(key: str, value: object):
    return lambda arm, _: arm.data["joints"][0].update({key: value})


def added(section: str, entry: dict[str, Any], **estimator: Any):
    def change(arm: ArmProject, _: object) -> None:
        arm.data[section] = [entry]
        arm.data["estimator"] = {**arm.data.get("estimator", {}), **estimator}

    return change


def watched(arm: ArmProject, _: object) -> None:
    del arm.data["star_tracker"]
    arm.data["estimator"] = {**arm.data.get("estimator", {}), "outside_wrench": "watch"}


NODE = {"bus": "arm", "node_id": 0x31, "rate_hz": 50.0}
WHEEL = NODE | {
    "name": "wheel1",
    "axis_B": [0.0, 0.0, 1.0],
    "inertia_kg_m2": 0.02,
    "speed_limit_rad_s": 700.0,
    "speed_noise_rad_s": 0.01,
    "torque_limit_nm": 0.4,
}
THRUSTER = NODE | {
    "name": "thruster1",
    "p_B_m": [0.0, 0.0, 0.9],
    "direction_B": [1.0, 0.0, 0.0],
    "force_n": 22.0,
}
TANK = {
    "name": "tank",
    "kind": "slosh",
    "p_B_m": [0.0, 0.0, 0.0],
    "mass_kg": 2.0,
    "frequency_hz": 0.1,
    "damping_ratio": 0.01,
    "amplitude_m": 0.005,
}

DESCRIPTIONS = {
    "axis of a wheel not of length 1": added("wheels", WHEEL | {"axis_B": [1.0, 1.0, 1.0]}),
    "wheel on another bus": added("wheels", WHEEL | {"bus": "leg"}),
    "direction of a thruster not of length 1": added(
        "thrusters", THRUSTER | {"direction_B": [22.0, 0.0, 0.0]}
    ),
    "thruster that reports faster than SYNC": added("thrusters", THRUSTER | {"rate_hz": 400.0}),
    "liquid without an amplitude": added("modes", TANK | {"amplitude_m": None}),
    "liquid with the amplitude of a panel": added("modes", TANK | {"amplitude_rad": 0.01}),
    "mode too fast for the windows": added("modes", TANK | {"frequency_hz": 10.0}),
    "modes with a method that has none": added("modes", TANK, method="mrnea"),
    "contact watched with modes": added("modes", TANK, outside_wrench="watch"),
    "contact watched without a star tracker": watched,
    "prismatic joint configured as a revolute one": lambda arm, _: arm.robot(3, "prismatic"),
    "planar joint": lambda arm, _: arm.robot(3, "planar"),
    "joint that mimics another": lambda arm, _: replaced(
        arm, "<limit", '<mimic joint="axis2"/><limit'
    ),
    "placeholder in place of a limit": lambda arm, _: replaced(arm, 'effort="50"', 'effort="0"'),
    "missing inertia": lambda arm, _: replaced(arm, LINK2, '<link name="link2"/>'),
    "inertia in kg mm^2": lambda arm, _: replaced(
        arm, LINK2, LINK2.replace("0.04", "40000").replace("0.01", "10000")
    ),
    "millimetres": lambda arm, _: replaced(arm, 'xyz="0 0 0.4"', 'xyz="0 0 400"'),
    "degrees": set_joint("zero_offset_rad", 90.0),
    "degrees in the limits of a joint": lambda arm, _: replaced(arm, 'lower="-3"', 'lower="-170"'),
    "degrees in the speed of a joint": set_joint("speed_limit_rad_s", 28.6),
    "degrees in a mounting": lambda arm, _: arm.data["imu"].update(
        mounting={"p_BS_m": [0.0, 0.0, 0.0], "rpy_BS_rad": [0, 90, 0]}
    ),
    "xacro": lambda arm, _: replaced(
        arm, "<link", '<xacro:include xmlns:xacro="http://www.ros.org/wiki/xacro"/><link'
    ),
    "two joints on one node": twice,
    "names of other joints": set_joint("name", "joint1"),
    "misspelt key": lambda arm, _: arm.data["imu"].update(gyro_bias_sigma=1e-5),
    "no such tool frame": lambda arm, _: arm.data["robot"].update(tool_frame="hand"),
    "quaternion not of length 1": lambda arm, _: arm.data["imu"]["mounting"].update(
        q_BS_xyzw=[0.0, 0.0, 0.7, 0.7]
    ),
    "bus too slow": lambda arm, _: arm.data["buses"][0].update(bitrate=125_000),
    "serial port missing": lambda _arm, _: None,
    "no permission": forbidden,
    "no CAN interface": lambda arm, _: channel(arm),
    "CAN interface down": down,
}
FILES = {
    "tab in YAML": b"robot:\n\turdf: arm.urdf\n",
    "recording in place of the configuration": b"\x89MCAP0\r\n",
    "limits in place of the configuration": (
        PAGE.parents[1] / "inspector" / "limits.yaml"
    ).read_bytes(),
}


def wrong_sign(data: Any) -> None:
    data["joints"][2]["sign"] *= -1


def torque_sign(data: Any) -> None:
    data["joints"][1]["torque_gain"] = -1.0


def swapped(data: Any) -> None:
    first, second = data["joints"][1], data["joints"][3]
    first["node_id"], second["node_id"] = second["node_id"], first["node_id"]


def quaternion_order(data: Any) -> None:
    x, y, z, w = data["imu"]["mounting"]["q_BS_xyzw"]
    data["imu"]["mounting"]["q_BS_xyzw"] = [w, x, y, z]


def turned(data: Any) -> None:
    data["imu"]["mounting"] = {
        "p_BS_m": data["imu"]["mounting"]["p_BS_m"],
        "q_BS_xyzw": [0.5, 0.5, 0.5, 0.5],
    }


def lever_arm(data: Any) -> None:
    data["imu"]["mounting"]["p_BS_m"][0] += 0.5


def another_bus(data: Any) -> None:
    data["buses"][0]["name"] = "leg"
    for joint in data["joints"]:
        joint["bus"] = "leg"


def noise_in_degrees(data: Any) -> None:
    data["imu"]["angle_random_walk_rad_sqrt_s"] *= 57.3


def in_grams(data: Any) -> None:
    path = Path(data["robot"]["urdf"])
    text = re.sub(
        r'mass value="([^"]+)"', lambda m: f'mass value="{30 * float(m[1])}"', path.read_text()
    )
    path = path.with_name("grams.urdf")
    path.write_text(text)
    data["robot"]["urdf"] = str(path)


def light_base(data: Any) -> None:
    data["bodies"]["base"]["mass_kg"] /= 10.0


def little_noise(data: Any) -> None:
    data["joints"][2]["torque_noise_nm"] /= 1.6


CONFIGURATIONS = {
    "window too long for the motion": lambda data: data.update(estimator={"window_s": 3.2}),
    "noise declared 1.6 times too small": little_noise,
    "mass of the base": light_base,
    "wrong sign": wrong_sign,
    "wrong sign of a torque": torque_sign,
    "swapped joints": swapped,
    "order of a quaternion": quaternion_order,
    "inertial unit turned": turned,
    "lever arm": lever_arm,
    "sense of the star tracker": lambda data: data["star_tracker"].update(
        rotation="tracker_to_inertial"
    ),
    "inertial unit at another rate": lambda data: data["imu"].update(rate_hz=250.0),
    "noise in degrees": noise_in_degrees,
    "masses in grams": in_grams,
    "another bus": another_bus,
}


def noise(topic: str, _s: float, data: bytes) -> tuple[float, bytes]:
    is_imu = topic == "/serial/imu"
    return 0.0, np.random.default_rng(len(data)).bytes(len(data)) if is_imu else data


def cut(source: Path, target: Path) -> Path:
    content = source.read_bytes()
    target.write_bytes(content[: len(content) // 2])
    return target


def cut_at_once(source: Path, target: Path) -> Path:
    target.write_bytes(source.read_bytes()[:300])
    return target


def empty(_source: Path, target: Path) -> Path:
    target.write_bytes(b"")
    return target


RECORDINGS = {
    "wrong baud rate": lambda source, target: rewritten(source, target, noise),
    "clock set back": lambda source, target: rewritten(
        source, target, lambda _topic, s, data: (-2.0 if s > 10.0 else 0.0, data)
    ),
    "hole in the data": lambda source, target: rewritten(
        source, target, lambda _topic, s, data: (3.0 if s > 10.0 else 0.0, data)
    ),
    "cut off": cut,
    "cut off at once": cut_at_once,
    "configuration in place of the recording": lambda source, _: source.with_name("flight.yaml"),
    "empty file": empty,
}


def assert_one_line(capsys: pytest.CaptureFixture[str], words: str) -> None:
    said = capsys.readouterr()
    lines = [line for line in (said.out + said.err).splitlines() if words in line]
    assert len(lines) == 1, said.out + said.err
    assert "Traceback" not in said.err


def test_every_mistake_of_the_page_is_made_here():
    apart = {"base fixed to world", "another robot", *SAMPLED, *FIRST}
    made = [*DESCRIPTIONS, *FILES, *CONFIGURATIONS, *RECORDINGS, *apart]
    assert sorted(made) == sorted(mistake for mistake, _, _ in ROWS)
    before_wires = PAGE.read_text(encoding="utf-8").partition("\n## Wires of drives")[0]
    shown = before_wires.count("\n| ") - before_wires.count("\n| mistake |")
    assert len(ROWS) == shown  # those of wires: test_check_wires.py


@pytest.mark.parametrize(
    ("mistake", "command", "words"), [row for row in ROWS if row[0] not in SAMPLED | FIRST]
)
def test_a_mistake_is_one_line_that_says_what_to_do(
    mistake, command, words, arm, flown, tmp_path, monkeypatch, capsys
):
    recording, config = flown / "recording.mcap", tmp_path / "tried.yaml"
    data = yaml.safe_load((flown / "flight.yaml").read_text())
    data["robot"]["urdf"] = str(flown / data["robot"]["urdf"])
    if command == "fsw init":
        replaced(arm, '<robot name="arm">', f'<robot name="arm">{WORLD}')
        arm.write()
        assert main(["init", str(arm.folder / "arm.urdf"), "--out", str(config)]) == 2
    elif mistake in DESCRIPTIONS:
        DESCRIPTIONS[mistake](arm, monkeypatch)
        main(["check", str(arm.write())])
    elif mistake in FILES:
        config.write_bytes(FILES[mistake])
        assert main(["check", str(config)]) == 2
    else:
        if mistake == "another robot":
            config = arm.write()
        else:
            CONFIGURATIONS.get(mistake, lambda _: None)(data)
            config.write_text(yaml.safe_dump(data))
        if mistake in RECORDINGS:
            recording = RECORDINGS[mistake](recording, tmp_path / "other.mcap")
        assert main(["check", str(config), str(recording)]) in (1, 2) or mistake == "cut off"
    assert_one_line(capsys, words)


def test_a_recording_that_is_cut_off_is_used_as_far_as_it_goes(flown, tmp_path, capsys):
    path, config = cut(flown / "recording.mcap", tmp_path / "cut.mcap"), flown / "flight.yaml"
    for command in ("replay", "identify"):
        main([command, str(path), "--config", str(config)])
        said = capsys.readouterr()
        assert re.search(r"is cut off at its end; \d+\.\d s of it were read", said.out + said.err)


def test_a_line_without_a_usable_sample_is_told_by_identify(flown, tmp_path, capsys):
    path = rewritten(flown / "recording.mcap", tmp_path / "noise.mcap", noise)
    main(["identify", str(path), "--config", str(flown / "flight.yaml")])
    assert "imu: NOTHING USABLE; 0 samples" in capsys.readouterr().out
