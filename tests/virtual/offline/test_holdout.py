"""`fsw identify --holdout` on a flight in virtual time: a right model passes, a wrong one fails."""

import json

import numpy as np
import pytest
import yaml

from fsw.__main__ import main


def held_out(flown, tmp_path, capsys, change) -> tuple[int, dict]:
    data = yaml.safe_load((flown / "flight.yaml").read_text())
    data["robot"]["urdf"] = str(flown / "robot.urdf")
    change(data)
    config = tmp_path / "flight.yaml"
    config.write_text(yaml.safe_dump(data))
    command = ["identify", str(flown / "recording.mcap"), "--config", str(config)]
    code = main([*command, "--method", "mrnea", "--holdout", "0.3", "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_a_right_model_predicts_what_it_has_not_seen(flown, tmp_path, capsys):
    code, result = held_out(flown, tmp_path, capsys, lambda _data: None)
    holdout = result["holdout"]
    assert holdout["passed"], holdout
    assert code == (0 if result["status"] == "OK" else 1)
    assert set(holdout["channels"]) >= {"torque.joint1", "specific_force.x", "rate.z"}
    assert holdout["windows"] > 5
    ratios = [channel["rms_over_sigma"] for channel in holdout["channels"].values()]
    assert 0.6 < np.median(ratios) < 1.2


def test_a_wrong_zero_of_a_joint_fails_by_name(flown, tmp_path, capsys):
    def turned(data):
        data["joints"][1]["zero_offset_rad"] += 0.2
        data["joints"][1]["zero_sigma_rad"] = 0.0

    code, result = held_out(flown, tmp_path, capsys, turned)
    holdout = result["holdout"]
    assert code == 1
    assert not holdout["passed"]
    failed = [name for name, channel in holdout["channels"].items() if not channel["passed"]]
    assert failed
    assert "MODEL_MISMATCH" in result["reasons"]
    assert result["note"].startswith("held-out windows are not predicted: ")
    assert result["diagnosis"]["parameters"]["target"]["mass_kg"] == "not valid"


def test_what_no_motion_shows_is_known_by_the_prior_alone(flown, tmp_path, capsys):
    """A prior of the mass that is far tighter than what the flight can say."""

    def certain(data):
        data["bodies"]["target"]["mass_kg"] = 400.0
        data["bodies"]["target"]["sigma"]["mass_kg"] = 1e-6

    _, result = held_out(flown, tmp_path, capsys, certain)
    assert result["names"][0] in result["holdout"]["prior_only"], "the mass"
    assert result["names"][1] not in result["holdout"]["prior_only"]


@pytest.mark.parametrize("share", ["0", "1", "nan"])
def test_a_wrong_share_is_one_line(flown, capsys, share):
    command = ["identify", str(flown / "recording.mcap"), "--config", str(flown / "flight.yaml")]
    assert main([*command, "--holdout", share]) == 2
    assert "--holdout" in capsys.readouterr().err.splitlines()[-1]
