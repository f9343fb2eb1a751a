"""A configuration judged by a recording: mistakes are named from the data alone."""

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from fsw.__main__ import main
from offline.checks.recorded import rate_words
from tests.support.rewritten import rewritten


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


def test_what_check_finds_wrong_is_a_warning_of_identify_and_its_holdout_does_not_pass(
    flown, tmp_path, capsys
):
    """The inertial unit's clock is 30 ms late; all bytes come as they were sent."""

    def late(topic: str, _s: float, data: bytes) -> tuple[float, bytes]:
        return (0.03 if topic == "/serial/imu" else 0.0), data

    config = str(flown / "flight.yaml")
    command = ["--config", config, "--holdout", "0.3", "--json"]
    results = {}
    for name, path in {
        "right": flown / "recording.mcap",
        "late": rewritten(flown / "recording.mcap", tmp_path / "late.mcap", late),
    }.items():
        main(["identify", str(path), *command])
        results[name] = json.loads(capsys.readouterr().out)
    assert not [line for line in results["right"]["warnings"] if "WRONG" in line]
    assert results["right"]["holdout"]["passed"]
    assert [line for line in results["late"]["warnings"] if "WRONG" in line]
    assert not results["late"]["holdout"]["passed"]


def test_stamps_in_another_unit_of_time_are_named_as_such():
    """Milliseconds read as seconds, seconds as milliseconds; a rate of 125 for 250 is none."""
    assert "1000 times too large" in rate_words("imu.rate_hz", 250.0, 0.25)
    assert "1000 times too small" in rate_words("imu.rate_hz", 250.0, 2.5e5)
    assert "1e+06 times too small" in rate_words("imu.rate_hz", 250.0, 2.5e8)
    assert not rate_words("imu.rate_hz", 250.0, 125.0)
    both = rate_words("imu.rate_hz", 500.0, 2.5e5)
    assert "1000 times too small" in both
    assert both.endswith("and set imu.rate_hz to 250")
