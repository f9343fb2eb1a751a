"""`fsw calibrate` on simulated recordings: figures against the truth's errors, and refusals."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from fsw.__main__ import main
from hil.run.bench import prepare, run_virtual
from hil.world.sensor_config import SensorConfig
from hil.world.sensors import ImuErrors, JointErrors
from tests.support.short_cases import NoMeter, short

SEED, REST_S = 1, 12.0
SIGMAS = 3.0


@pytest.fixture(scope="module")
def rested(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with a long rest before a short motion."""
    folder = tmp_path_factory.mktemp("rested")
    scenario = replace(short(folder, hurry=2.0), before_s=REST_S)
    run_virtual(prepare(scenario, SEED, folder), NoMeter(), record=True)
    return folder


def calibrated(folder: Path, mode: str, *options: str) -> int:
    recording, config = folder / "recording.mcap", folder / "flight.yaml"
    return main(["calibrate", mode, str(recording), "--config", str(config), *options])


def true_errors(folder: Path) -> dict[str, float]:
    """The errors that the devices were given, by the names of the figures."""
    sensors = SensorConfig.from_dict(short(folder).sensors)
    n = len(sensors.joints.nodes)
    offsets = JointErrors(sensors.joints, n, SEED).torque_offset_nm
    imu = ImuErrors(sensors.imu, SEED)
    return {
        **{f"torque_offset.joint{k + 1}": offset for k, offset in enumerate(offsets.tolist())},
        **dict(zip([f"gyro_bias.{a}" for a in "xyz"], imu.gyro_bias_rad_s, strict=True)),
        **dict(zip([f"acc_bias.{a}" for a in "xyz"], imu.acc_bias_m_s2, strict=True)),
    }


def test_at_rest_every_figure_is_within_three_sigma_and_the_overlay_holds_them(
    rested, tmp_path, capsys
):
    out = tmp_path / "calibration.yaml"
    code = calibrated(rested, "rest", "--to", str(REST_S), "--out", str(out), "--json")
    result = json.loads(capsys.readouterr().out)
    assert code == 0
    truth = true_errors(rested)
    figures = {figure["name"]: figure for figure in result["figures"]}
    assert set(figures) == set(truth)
    for name, figure in figures.items():
        assert abs(figure["value"] - truth[name]) < SIGMAS * figure["sigma"], name
    shown = [name for name, figure in figures.items() if figure["verdict"] == "measured"]
    assert {name for name in truth if "gyro" not in name} <= set(shown)
    text = out.read_text()
    assert yaml.safe_load(text) == result["overlay"]
    assert f"# fsw calibrate rest {rested / 'recording.mcap'}" in text
    assert main(["check", str(rested / "flight.yaml"), "--overlay", str(out)]) == 0
    capsys.readouterr()
    again = calibrated(rested, "rest", "--to", str(REST_S), "--overlay", str(out), "--json")
    left = {f["name"]: f for f in json.loads(capsys.readouterr().out)["figures"]}
    assert again == 1  # it shows nothing that its own overlay does not state
    assert all(abs(left[name]["value"]) < 1e-2 * left[name]["sigma"] for name in shown)


def test_a_robot_that_moves_is_refused_in_words(rested, tmp_path, capsys):
    out = tmp_path / "calibration.yaml"
    assert calibrated(rested, "rest", "--out", str(out)) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert "the robot moves: joint" in error
    assert "after 12." in error
    assert not out.exists()


def test_without_a_tracker_a_base_that_turns_is_not_taken_for_a_bias(rested, tmp_path, capsys):
    data = yaml.safe_load((rested / "flight.yaml").read_text())
    del data["star_tracker"]
    data["imu"]["gyro_bias_S_rad_s"] = [1e-3, 0.0, 0.0]  # as if the base turned by as much
    data["robot"]["urdf"] = str(rested / "robot.urdf")
    config = tmp_path / "robot.yaml"
    config.write_text(yaml.safe_dump(data))
    recording = str(rested / "recording.mcap")
    code = main(["calibrate", "rest", recording, "--config", str(config), "--to", str(REST_S)])
    assert code == 1
    assert "cannot be distinguished from a bias" in capsys.readouterr().err.splitlines()[-1]


def test_a_turn_that_the_tracker_sees_is_no_rest(rested, monkeypatch, capsys):
    monkeypatch.setattr("offline.calibrate.rest.TURNING_RAD_S", 1e-9)
    assert calibrated(rested, "rest", "--to", str(REST_S)) == 1
    assert "by the star tracker, at rest" in capsys.readouterr().err.splitlines()[-1]


def test_too_short_a_rest_is_refused(rested, capsys):
    assert calibrated(rested, "rest", "--to", "2") == 1
    assert "usable windows at rest; must be 8 or more" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["flight.yaml", "recording.mcap", "none/out.yaml"])
def test_a_wrong_output_is_one_line(rested, name, capsys):
    before = (rested / "flight.yaml").read_bytes()
    code = calibrated(rested, "rest", "--to", str(REST_S), "--out", str(rested / name))
    assert code == 2
    assert "--out" in capsys.readouterr().err.splitlines()[-1]
    assert (rested / "flight.yaml").read_bytes() == before


def test_the_sigma_counts_noise_as_it_is_found(rested, capsys):
    calibrated(rested, "rest", "--to", str(REST_S), "--json")
    figures = {f["name"]: f for f in json.loads(capsys.readouterr().out)["figures"]}
    config = yaml.safe_load((rested / "flight.yaml").read_text())
    white = config["imu"]["velocity_random_walk_m_s_sqrt_s"] / np.sqrt(REST_S)
    assert white < figures["acc_bias.x"]["sigma"] < 5.0 * white


WRONG = {
    "imu": {
        "mounting": {"p_BS_m": [-0.27, 0.16, -0.48], "q_BS_xyzw": [0.5, -0.5, 0.5, 0.5]},
        "mounting_position_sigma_m": 0.05,
        "gyro_group_delay_s": 0.012,
    },
    "star_tracker": {"latency_s": 0.12},
}


@pytest.fixture(scope="module")
def wrong(rested: Path) -> Path:
    """An overlay with a wrong lever arm and wrong delays."""
    path = rested / "wrong.yaml"
    path.write_text(yaml.safe_dump(WRONG))
    return path


def test_in_motion_errors_of_the_configuration_are_found_and_then_identified_without(
    rested, wrong, tmp_path, capsys
):
    out, laid = tmp_path / "calibration.yaml", ["--overlay", str(wrong)]
    assert calibrated(rested, "motion", *laid, "--out", str(out), "--json") == 0
    figures = {f["name"]: f for f in json.loads(capsys.readouterr().out)["figures"]}
    truth = true_errors(rested) | {
        **{f"torque_scale.joint{k}": 0.0 for k in range(1, 8)},
        **{f"torque_delay.joint{k}": 0.0 for k in range(1, 8)},
        **{f"imu_angle.{axis}": 0.0 for axis in "xyz"},
        "imu_place.x": -0.03,
        "imu_place.y": 0.04,
        "imu_place.z": 0.03,
        "delay.gyro": -0.0098,
        "delay.accelerometer": 0.0,
        "delay.star_tracker": -0.02,
    }
    assert set(figures) == set(truth)
    shown = [name for name, figure in figures.items() if figure["verdict"] == "measured"]
    assert not [name for name in shown if name.startswith("torque_delay")]
    for name in [*shown, *(name for name in truth if name.startswith("torque_delay"))]:
        off = abs(figures[name]["value"] - truth[name])
        assert off < SIGMAS * figures[name]["sigma"], name
    assert {"delay.gyro", "delay.star_tracker", "imu_angle.x", "torque_scale.joint1"} <= set(shown)

    def masses(*overlays: Path) -> tuple[str, float]:
        options = [word for path in overlays for word in ("--overlay", str(path))]
        recording, config = rested / "recording.mcap", rested / "flight.yaml"
        main(["identify", str(recording), "--config", str(config), *options, "--json"])
        result = json.loads(capsys.readouterr().out)
        mass = result["estimate"]["target"]["mass_kg"] - 400.0
        return result["status"], mass / result["sigma"]["target"]["mass_kg"]

    before, after = masses(wrong), masses(wrong, out)
    assert before[0] != "OK" or abs(before[1]) > SIGMAS
    assert after[0] == "OK"
    assert abs(after[1]) < SIGMAS


def test_data_that_no_calibration_explains_are_refused(rested, tmp_path, capsys):
    path, out = tmp_path / "swapped.yaml", tmp_path / "out.yaml"
    path.write_text(yaml.safe_dump({"joints": [{"name": "joint2", "sign": 1}]}))
    code = calibrated(rested, "motion", "--overlay", str(path), "--out", str(out))
    assert code == 1
    assert "no figures" in capsys.readouterr().err.splitlines()[-1]
    assert not out.exists()
