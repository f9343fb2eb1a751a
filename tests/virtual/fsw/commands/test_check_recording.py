"""A configuration judged by a recording: mistakes are named from the data alone."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from fsw.__main__ import main


def little_noise(data: Any) -> tuple[str, ...]:
    for joint in data["joints"]:
        joint["torque_noise_nm"] /= 10.0
    return ("joints.0.torque_noise_nm", "the data are noisier")


def checked(folder: Path, data: Any, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    path = folder / "tried.yaml"
    path.write_text(yaml.safe_dump(data))
    code = main(["check", str(path), str(folder / "recording.mcap")])
    return code, capsys.readouterr().out


def test_a_correct_configuration_agrees_with_its_recording(flown, capsys):
    code, out = checked(flown, yaml.safe_load((flown / "flight.yaml").read_text()), capsys)
    assert (code, "WRONG" in out) == (0, False), out
    assert "agree" in out.splitlines()[-1]


def test_noise_that_is_too_small_is_named_from_the_data(flown, capsys):
    data = yaml.safe_load((flown / "flight.yaml").read_text())
    words = little_noise(data)
    code, out = checked(flown, data, capsys)
    wrong = "\n".join(line for line in out.splitlines() if "WRONG" in line)
    assert code == 1
    assert [word for word in words if word not in wrong] == [], out
