"""Overlay files: they replace what they name and nothing else, and a fault is one line."""

import pytest
import yaml

from fsw.config import load, parse
from fsw.config.overlay_file import with_overlays
from fsw.errors import ConfigError
from tests.conftest import ArmProject


def laid(arm: ArmProject, *overlays: object):
    folder = arm.folder
    paths = [folder / f"{k}.yaml" for k in range(len(overlays))]
    for path, values in zip(paths, overlays, strict=True):
        path.write_text(yaml.safe_dump(values))
    return with_overlays(load(arm.write()), paths)


def test_only_what_is_named_changes_and_the_text_holds_it(arm):
    before = load(arm.write())
    name = before.joints[1].name
    after = laid(
        arm,
        {"joints": [{"name": name, "torque_offset_nm": 0.25}]},
        {"imu": {"mounting": {"rpy_BS_rad": [0.0, 0.0, 0.0]}, "gyro_group_delay_s": 0.004}},
    )
    assert after.joints[1].torque_offset_nm == 0.25
    assert after.imu.mounting.q_BS_xyzw == (0.0, 0.0, 0.0, 1.0)
    assert after.imu.mounting.p_BS_m == before.imu.mounting.p_BS_m
    changed = after.model_dump()
    changed["joints"][1]["torque_offset_nm"] = before.joints[1].torque_offset_nm
    changed["imu"]["mounting"] = before.imu.mounting.model_dump()
    changed["imu"]["gyro_group_delay_s"] = before.imu.gyro_group_delay_s
    assert changed == before.model_dump()
    assert parse(after.source, arm.folder, "again").model_dump() == after.model_dump()
    assert after.resolve(after.robot.urdf) == before.resolve(before.robot.urdf)
    assert after.name.endswith("1.yaml")


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"joints": [{"name": "nobody", "torque_gain": 1.0}]}, "joints.name: 'nobody' must be one"),
        ({"imu": {"gyro_delay_s": 0.1}}, "did you mean 'gyro_group_delay_s'?"),
        ({"imu": {"gyro_group_delay_s": -1.0}}, "imu.gyro_group_delay_s: must be at least 0"),
        ([1, 2], "must be a mapping of sections; found list"),
    ],
)
def test_a_fault_is_one_line_that_names_the_key(arm, values, words):
    with pytest.raises(ConfigError) as raised:
        laid(arm, values)
    assert words in str(raised.value)
    assert "0.yaml" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_missing_file_is_named(arm):
    with pytest.raises(ConfigError, match=r"none\.yaml: cannot be read: No such file"):
        with_overlays(load(arm.write()), [arm.folder / "none.yaml"])
