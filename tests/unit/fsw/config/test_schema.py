"""The JSON Schema: editors refuse what the configuration refuses."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from jsonschema import Draft202012Validator

from fsw.__main__ import main
from fsw.config import Config, load, parse
from fsw.config.joints import linear
from fsw.config.reference import json_schema
from fsw.errors import ConfigError
from tests.conftest import arm_config

ROOT = Path(__file__).parents[4]


def examples() -> Iterator[dict]:
    yield arm_config(3)
    text = (ROOT / "docs" / "configuration.md").read_text()
    yield yaml.safe_load(text.split("```yaml")[1].split("```")[0])


@pytest.mark.parametrize("data", list(examples()))
def test_a_correct_configuration_passes(data):
    Draft202012Validator.check_schema(json_schema())
    assert [error.message for error in Draft202012Validator(json_schema()).iter_errors(data)] == []


def test_angles_pass_in_the_place_of_a_quaternion():
    data = arm_config(3)
    del data["imu"]["mounting"]["q_BS_xyzw"]
    assert not Draft202012Validator(json_schema()).is_valid(data)
    data["imu"]["mounting"]["rpy_BS_rad"] = [0.0, 0.0, 1.0]
    assert Draft202012Validator(json_schema()).is_valid(data)


def test_a_gyros_matrix_is_near_the_identity(arm):
    arm.data["imu"]["gyro_matrix"] = [[1.0, 0.01, 0.0], [0.0, 0.98, 0.0], [0.0, 0.0, 1.0]]
    assert load(arm.write()).imu.gyro_matrix[1][1] == 0.98
    arm.data["imu"]["gyro_matrix"] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    with pytest.raises(ConfigError, match=r"gyro_matrix\[0\]\[0\]: 0; must be 1 within 0.2"):
        load(arm.write())


def test_a_joint_without_torque_sensor_needs_none_of_its_values():
    data = arm_config(3)
    of_sensor = ("torque_limit_nm", "torque_noise_nm", "torque_offset_sigma_nm")
    for key in of_sensor:
        joint = data["joints"][1]
        kept = joint.pop(key)
        assert not Draft202012Validator(json_schema()).is_valid(data)
        joint[key] = kept
    data["joints"][1] = {k: v for k, v in joint.items() if k not in of_sensor} | {"torque": "none"}
    assert Draft202012Validator(json_schema()).is_valid(data)
    joint = Config.model_validate(data).joints[1]
    assert joint.torque_offset_sigma_nm == joint.torque_scale_sigma_ratio == 0.0
    data["estimator"] = {"method": "mrnea"}
    with pytest.raises(ValueError, match=r"estimator\.method.*torque: none"):
        Config.model_validate(data)


def by_speed(data, **changes):
    joint = data["joints"][1]
    kept = {
        key: v for key, v in joint.items() if key not in ("position_noise_rad", "zero_offset_rad")
    }
    data["joints"][1] = kept | {"encoder": "speed", "speed_noise_rad_s": 0.01} | changes
    return data


def test_a_joint_known_by_speed_needs_the_noise_of_its_speed_and_no_other():
    data = by_speed(arm_config(3))
    assert Draft202012Validator(json_schema()).is_valid(data)
    config = Config.model_validate(data)
    assert config.joints[1].start_rad == 0.0
    assert Config.model_validate(config.model_dump()).joints == config.joints
    del data["joints"][1]["speed_noise_rad_s"]
    assert not Draft202012Validator(json_schema()).is_valid(data)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"speed_noise_rad_s": None}, "speed_noise_rad_s: missing; encoder: speed needs it"),
        ({"zero_offset_rad": 0.3}, "zero_offset_rad: 0.3 has no meaning with encoder: speed"),
        ({"encoder": "position", "position_noise_rad": 1e-6}, "speed_noise_rad_s: 0.01 needs enco"),
        ({"encoder": "clock"}, "encoder"),
    ],
)
def test_keys_that_do_not_go_with_the_encoder_are_told(changes, message):
    with pytest.raises(ValueError, match=message):
        Config.model_validate(by_speed(arm_config(3), **changes))


@pytest.mark.parametrize(
    ("estimator", "key"),
    [
        ({"method": "mrnea"}, "estimator.method: 'mrnea' needs the position of every joint"),
        ({"external_force_sigma_n": 1.0}, "estimator.external_force_sigma_n: is not known if"),
    ],
)
def test_what_does_not_go_with_integrated_angles_is_told(estimator, key):
    with pytest.raises(ValueError, match=key):
        Config.model_validate(by_speed(arm_config(3)) | {"estimator": estimator})


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("imu", "colour", "red"),
        ("imu", "rate_hz", "fast"),
        ("imu", "rate_hz", -1.0),
        ("scheduler", "realtime_priority", 100),
        ("star_tracker", "rotation", "left"),
    ],
)
def test_a_wrong_value_fails(section, key, value):
    data = arm_config(3)
    data[section][key] = value
    assert not Draft202012Validator(json_schema()).is_valid(data)


def test_the_command_prints_it(capsys):
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == json_schema()


def test_a_prismatic_joint_has_keys_in_metres_and_newtons():
    data = arm_config(3)
    data["joints"][1] = {linear(key): value for key, value in data["joints"][1].items()}
    assert not Draft202012Validator(json_schema()).is_valid(data)  # revolute
    data["joints"][1]["kind"] = "prismatic"
    assert Draft202012Validator(json_schema()).is_valid(data)
    config = Config.model_validate(data)
    assert config.joints[1].torque_limit_nm == data["joints"][1]["force_limit_n"]
    assert Config.model_validate(config.model_dump()) == config  # as the effective one is written


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"force_limit_n": -1.0}, r"joints\.1\.force_limit_n"),
        ({"force_limit_n": None}, r"joints\.1\.force_limit_n: missing"),
        ({"torque_noise_nm": 0.1}, "torque_noise_nm: of a prismatic joint it is force_noise_n"),
        ({"colour": "{red}"}, r"joints\.1\.colour: unknown key"),
    ],
)
def test_a_fault_of_a_prismatic_joint_has_its_own_key(changes, words):
    data = arm_config(3)
    joint = {linear(key): value for key, value in data["joints"][1].items()} | changes
    data["joints"][1] = {"kind": "prismatic"} | {k: v for k, v in joint.items() if v is not None}
    with pytest.raises(ConfigError, match=words):
        parse(yaml.safe_dump(data).encode(), Path("/"), "robot.yaml")
