"""The paper's band-limited white noise in its readings, and hysteresis."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml

from evidence.methods.flight_side import write_config
from hil.run.flight_sensors import position_noise_rad, torque_noise_nm
from hil.world.noise import BandLimitedWhiteNoise, Hysteresis, NoiseStream
from hil.world.scenario import load
from hil.world.sensor_config import NodeConfig
from hil.world.sensors import ImuErrors, JointErrors
from tests.support.plant_cases import sensor_config

PAPER = BandLimitedWhiteNoise()
LITERAL = BandLimitedWhiteNoise(reading="literal")
MEAN = BandLimitedWhiteNoise(reading="literal", decimation="average")


@pytest.mark.parametrize(
    ("noise", "rate_hz", "expected"),
    [
        (PAPER, 100.0, math.sqrt(0.1) * 0.01),
        (PAPER, 10_000.0, 3.162e-3),
        (LITERAL, 500.0, math.sqrt(0.1 / 1e-4) * 0.01),
        (MEAN, 100.0, 0.0316),
        (MEAN, 10.0, 0.0100),
    ],
)
def test_readings_have_their_sigma(noise: BandLimitedWhiteNoise, rate_hz: float, expected: float):
    """Said and drawn: 4000 samples, 5 % is 4.5 sigma of a standard deviation."""
    assert noise.sigma(rate_hz) == pytest.approx(expected, rel=2e-3)
    drawn = NoiseStream(noise, rate_hz, 3, 1).take(4000 if rate_hz > 50 else 1500)
    assert drawn.std() == pytest.approx(expected, rel=0.05)


def test_picking_keeps_one_of_the_held_values_and_the_rate_must_divide():
    """The stream at 100 Hz is every hundredth value of the stream at 10 kHz."""
    fast = NoiseStream(PAPER, 10_000.0, 1, 3).take(1000)
    slow = NoiseStream(PAPER, 100.0, 1, 3).take(10)
    assert np.array_equal(slow[:, 0], fast[::100, 0])
    mean = NoiseStream(MEAN, 100.0, 1, 3).take(10)
    literal = NoiseStream(LITERAL, 10_000.0, 1, 3).take(1000)
    assert np.allclose(mean[:, 0], literal[:, 0].reshape(10, 100).mean(axis=1))
    with pytest.raises(ValueError, match="does not divide"):
        PAPER.sigma(333.0) if PAPER.decimation == "average" else PAPER.held(333.0)


def test_one_seed_can_mean_one_sequence_everywhere():
    shared = BandLimitedWhiteNoise(shared=True)
    a, b = (
        NoiseStream(shared, 500.0, 7, 1, 0).take(20),
        NoiseStream(shared, 500.0, 3, 2, 1).take(20),
    )
    assert np.array_equal(a[:, 0], b[:, 2])
    assert np.ptp(a, axis=1).max() == 0.0
    own = NoiseStream(PAPER, 500.0, 7, 1, 0).take(20)
    other = NoiseStream(PAPER, 500.0, 7, 1, 1).take(20)
    assert np.abs(own - other).min() > 0
    assert np.ptp(own, axis=1).min() > 0


def test_a_profile_replaces_the_channels_own_noise():
    """And the flight side is told its sigma."""
    paper = {"reading": "variance"}
    config = sensor_config(
        joints={"torque_noise": paper, "position_noise": paper, "torque_noise_nm": 9.0},
        imu={"gyro_noise": paper, "acc_noise": paper, "angle_random_walk_rad_sqrt_s": 9.0},
    )
    errors = JointErrors(config.joints, 7, 5)
    rows = [errors.measure(*np.zeros((3, 7))) for _ in range(2000)]
    for channel in range(2):
        assert np.std([row[channel] for row in rows]) == pytest.approx(3.162e-3, rel=0.03)
    assert config.imu is not None
    assert ImuErrors(config.imu, 5).next(5000).std(axis=0) == pytest.approx(3.162e-3, rel=0.05)
    node = NodeConfig(node_id=1)
    assert torque_noise_nm(config.joints, node, 500.0) == pytest.approx(
        math.hypot(3.162e-3, 0.01 / math.sqrt(12)), rel=1e-3
    )
    assert position_noise_rad(config.joints) == pytest.approx(3.162e-3, rel=1e-3)


def test_hysteresis_is_two_branches_whatever_the_speed():
    model = Hysteresis(0.04, 2.0, 1)
    up = np.linspace(-20, 20, 400)
    loop = np.concatenate([up, up[::-1], up, up[::-1]])
    error = np.array([model.error_nm(np.array([x]))[0] for x in loop])
    rising, falling = error[900:1150], error[1300:1550]
    assert np.allclose(rising, 0.04)
    assert np.allclose(falling, -0.04)
    slow = Hysteresis(0.04, 2.0, 1)
    again = np.array([slow.error_nm(np.array([x]))[0] for x in np.repeat(loop, 3)])[2::3]
    assert np.allclose(again, error)


def test_hysteresis_reaches_the_reading():
    config = sensor_config(joints={"torque_hysteresis_ratio": 0.001, "rated_torque_nm": 40.0})
    errors = JointErrors(config.joints, 1, 5)
    readings = [
        errors.measure(*np.zeros((2, 1)), np.array([x]))[1][0] for x in (0.0, 10.0, 0.0, -10.0)
    ]
    assert readings == pytest.approx([0.0, 10.04, -0.04, -10.04])


@pytest.mark.parametrize("profile", ["paper", "data_sheet", "ideal"])
def test_the_profiles_that_ship_are_readable_and_the_flight_side_takes_them(profile, tmp_path):
    scenario = load("target_leo")
    folder = scenario.urdf.parents[1] / "scenarios" / "common"
    text = (folder / f"sensors_{profile}.yaml").read_text(encoding="utf-8")
    config = write_config(replace(scenario, sensors=yaml.safe_load(text)), 1, tmp_path)
    assert config.joints[0].torque_noise_nm >= 0.01 / math.sqrt(12) - 1e-9
    expected = {"paper": 3.162e-3, "data_sheet": 9.84e-4, "ideal": 2.2e-8}[profile]
    sigma = config.imu.angle_random_walk_rad_sqrt_s * math.sqrt(config.imu.rate_hz)
    assert sigma == pytest.approx(expected, rel=0.02)
