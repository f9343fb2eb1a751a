"""What can be laid over a configuration, and what is refused."""

import pytest

from fsw.config.overlay import overlay
from fsw.errors import ConfigError
from tests.conftest import ArmProject
from tests.support.loop_cases import arm_config


@pytest.fixture
def config(arm: ArmProject):
    return arm_config(arm)


def test_nothing_laid_over_changes_nothing(config):
    assert overlay(config, {}) == config


def test_what_is_named_changes_and_nothing_else(config):
    noise = {
        "joints": {"axis2": {"torque_noise_nm": 0.3}},
        "imu": {"gyro_bias_sigma_rad_s": 1e-3},
        "star_tracker": {"noise_about_rad": 1e-4},
        "estimator": {"wrench_force_sigma_n": 0.5},
    }
    changed = overlay(config, {"noise": noise, "estimator": {"settle_blocks": 7}})
    assert [j.torque_noise_nm for j in changed.joints] == [0.05, 0.3, 0.05]
    assert changed.imu.gyro_bias_sigma_rad_s == 1e-3
    assert changed.star_tracker.noise_about_rad == 1e-4
    assert changed.estimator.wrench_force_sigma_n == 0.5
    assert changed.estimator.settle_blocks == 7
    assert changed.joints[0] == config.joints[0]
    assert changed.buses == config.buses
    assert changed.crc32 == config.crc32


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"unknown": ["base"]}, "bodies.base"),
        ({"noise": {"joints": {"elbow": {}}}}, "elbow"),
        ({"noise": {"joints": {"axis1": {"torque_noise_nm": -1.0}}}}, "torque_noise_nm"),
        ({"noise": {"imu": {"rate_hz": 100.0}}}, "rate_hz"),
        ({"noise": {"joint": {}}}, "did you mean 'joints'"),
        ({"estimator": {"gate_probability": 0.5}}, "gate_probability"),
        ({"noise": [1]}, "must be a section"),
        (
            {
                "noise": {
                    "bodies": {
                        "box": {
                            "frame": "gripper",
                            "mass_kg": 1.0,
                            "com_m": [0, 0, 0],
                            "inertia_kg_m2": [1, 0, 0, 1, 0, 1],
                        }
                    }
                }
            },
            "bodies.box.frame: must be as configured",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_its_name(config, changes, word):
    with pytest.raises(ConfigError, match=word):
        overlay(config, changes)


def test_noise_of_a_star_tracker_that_is_not_there_is_refused(arm: ArmProject):
    del arm.data["star_tracker"]
    with pytest.raises(ConfigError, match="star_tracker"):
        overlay(arm_config(arm), {"noise": {"star_tracker": {"noise_about_rad": 1e-4}}})
