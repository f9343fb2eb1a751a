"""Seeds and settings of the command line: refused with key and value, before a folder is made."""

from pathlib import Path

import pytest

from hil.__main__ import main

WRONG = {
    "flight.estimator.window_s=-1": "estimator.window_s=-1: estimator.window_s: must be above 0",
    "flight.imu.gyro_scale_sigma_ratio=7": "flight has no section 'imu'; did you mean sensors.imu?",
    "flight.bus.rate_hz.x=7": "flight.bus has no section 'rate_hz'; it has: none",
    "flight.tick_rate_hz": "must be sensors.KEY=VALUE, flight.KEY=VALUE",
    "bodies.base=3": "must be sensors.KEY=VALUE, flight.KEY=VALUE",
}


@pytest.mark.parametrize("setting", WRONG)
@pytest.mark.parametrize("command", [["seeds", "base", "--count", "1"], ["run", "base", "--fast"]])
def test_a_wrong_setting_is_named_and_leaves_no_folder(
    command: list[str], setting: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main([*command, "--set", setting, "--out", str(out)]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert f"--set {setting}: " in said
    assert WRONG[setting] in said
    assert "/" not in said
    assert not out.exists()
