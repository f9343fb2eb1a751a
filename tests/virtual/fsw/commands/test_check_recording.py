"""A configuration judged by a recording: mistakes are named from the data alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from fsw.__main__ import main


def wrong_sign(data: Any) -> tuple[str, ...]:
    data["joints"][2]["sign"] *= -1
    return ("joints.2.sign (joint3): -1 should be 1",)


def swapped_nodes(data: Any) -> tuple[str, ...]:
    first, second = data["joints"][1], data["joints"][3]
    first["node_id"], second["node_id"] = second["node_id"], first["node_id"]
    return ("joints.1.node_id and joints.3.node_id (joint2, joint4): swapped",)


def quaternion_order(data: Any) -> tuple[str, ...]:
    mounting = data["imu"]["mounting"]
    x, y, z, w = mounting["q_BS_xyzw"]
    mounting["q_BS_xyzw"] = [w, x, y, z]
    return ("imu.mounting.q_BS_xyzw: is in the order w x y z",)


def tracker_sense(data: Any) -> tuple[str, ...]:
    data["star_tracker"]["rotation"] = "tracker_to_inertial"
    return ("star_tracker.rotation: the quaternion turns the other way",)


def slow_unit(data: Any) -> tuple[str, ...]:
    data["imu"]["rate_hz"] = 250.0
    return ("imu.rate_hz: declared 250, found 125; WRONG: set imu.rate_hz to 125",)


def little_noise(data: Any) -> tuple[str, ...]:
    for joint in data["joints"]:
        joint["torque_noise_nm"] /= 10.0
    return ("joints.0.torque_noise_nm", "the data are noisier")


def degrees(data: Any) -> tuple[str, ...]:
    data["imu"]["angle_random_walk_rad_sqrt_s"] *= 57.3
    return ("imu.angle_random_walk_rad_sqrt_s", "in another unit (degrees, hours)?")


MISTAKES = [
    *(wrong_sign, swapped_nodes, quaternion_order, tracker_sense, slow_unit, little_noise),
    degrees,
]


def checked(folder: Path, data: Any, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    path = folder / "tried.yaml"
    path.write_text(yaml.safe_dump(data))
    code = main(["check", str(path), str(folder / "recording.mcap")])
    return code, capsys.readouterr().out


def test_a_correct_configuration_agrees_with_its_recording(flown, capsys):
    code, out = checked(flown, yaml.safe_load((flown / "flight.yaml").read_text()), capsys)
    assert (code, "WRONG" in out) == (0, False), out
    assert "agree" in out.splitlines()[-1]


@pytest.mark.parametrize("spoil", MISTAKES)
def test_a_mistake_is_named_from_the_data(flown, capsys, spoil):
    data = yaml.safe_load((flown / "flight.yaml").read_text())
    words = spoil(data)
    code, out = checked(flown, data, capsys)
    wrong = "\n".join(line for line in out.splitlines() if "WRONG" in line)
    assert code == 1
    assert [word for word in words if word not in wrong] == [], out
