"""Noise that is correlated in time, from device bytes: found, named, and counted."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.estimators.model.robot import RobotModel
from fsw.estimators.noise.sensors import SensorNoise
from fsw.estimators.recursive.online import build_online
from hil.judge import judgement
from hil.run import bench
from hil.world.inertia import pi_of
from hil.world.scenario import ScenarioError, changed, load
from tests.support.short_cases import NoMeter, short

TIME_S = 0.02
SEEDS = (1, 2)
CHI2_999 = float(chi2.ppf(0.999, 10 * len(SEEDS)))
CODE = "NOISE_CORRELATED"


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    """Return setup, recorded flight and outcome of every seed."""
    return [flown(tmp_path_factory.mktemp("flight"), seed) for seed in SEEDS]


def flown(tmp_path, seed: int, name="target_leo", key="joints.torque_noise_correlation_s"):
    """Return setup, recorded flight and outcome of a flight with such noise."""
    scenario = replace(short(tmp_path, points=12, name=name), sensors=load(name).sensors)
    scenario = changed(scenario, [f"sensors.{key}={TIME_S}"])
    folder = tmp_path / f"{seed}"
    folder.mkdir()
    setup = bench.prepare(scenario, seed, folder)
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    return setup, recorded, judgement.judge(setup, judgement.make_case(setup), recorded)


def test_the_covariance_covers_the_error_and_the_sensors_are_named(flights):
    total = 0.0
    for _, recorded, outcome in flights:
        assert outcome["valid"], outcome["reason"]
        total += outcome["nees"]
        named = [event for event in recorded.events if event.code == CODE]
        assert len(named) == 1, "once, not at every block"
        assert "joint1 0.0" in named[0].text
        assert " ms" in named[0].text
    assert total < CHI2_999


def test_without_it_the_same_flights_are_confidently_wrong(flights, monkeypatch):
    """What this is for: a covariance that takes every sample as news is too small by far."""
    monkeypatch.setattr(SensorNoise, "learn", lambda _: False)
    total = 0.0
    for setup, recorded, _ in flights:
        robot = RobotModel(
            setup.config.resolve(setup.config.robot.urdf), setup.config.robot.tool_frame
        )
        online = build_online(setup.config, robot)
        for block in recorded.blocks:
            online.push(block)
        final = online.finish()
        error = final.mean[:10] - pi_of(setup.scenario.truth["target"])
        total += error @ np.linalg.solve(final.covariance[:10, :10], error)
    assert total > CHI2_999


def test_gyro_and_accelerometer_are_found_and_counted_too(tmp_path):
    _, recorded, outcome = flown(tmp_path, 1, "base", "imu.noise_correlation_s")
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < chi2.ppf(0.999, outcome["dof"])
    (named,) = [event for event in recorded.events if event.code == CODE]
    assert "gyro" in named.text
    assert "accelerometer" in named.text
    assert "joint" not in named.text


@pytest.mark.parametrize(
    "setting", ["sensors", "sensors.none.x=1", "bodies.base=1", "sensors.joints.torque_noise_nm=["]
)
def test_what_is_no_setting_is_refused_in_one_line(setting):
    with pytest.raises(ScenarioError, match="--set") as caught:
        changed(load("target_leo"), [setting])
    assert len(str(caught.value).splitlines()) == 1
