"""The limits file: every fault is named."""

import pytest

from fsw.errors import ConfigError
from fsw.estimators.model.robot import RobotModel
from planner.limits import JointLimits, load
from tests.support.excitation_cases import LIMITS_FILE, limits, subject
from tests.support.sliding import sliding_urdf


def test_the_paper_s_limits_are_read():
    assert load(LIMITS_FILE).torque_nm == 40.0


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ("torque_nm: 40.0|torque_nm: -1.0", "torque_nm"),
        ("torque_nm: 40.0|torque: 1.0", "did you mean 'torque_nm'"),
        ("tool_distance_m: 1.5|", "tool_distance_m: missing"),
        ("torque_nm: 40.0|torque_nm: .inf", "torque_nm"),
    ],
)
def test_a_fault_is_named(tmp_path, change, word):
    path = tmp_path / "limits.yaml"
    path.write_text(LIMITS_FILE.read_text().replace(*change.split("|")))
    with pytest.raises(ConfigError, match=word):
        load(path)


def test_no_mapping_no_yaml_no_file(tmp_path):
    path = tmp_path / "limits.yaml"
    for text, word in (("- 1", "mapping"), ("a: [", "not YAML")):
        path.write_text(text)
        with pytest.raises(ConfigError, match=word):
            load(path)
    with pytest.raises(ConfigError, match="cannot be read"):
        load(tmp_path / "none.yaml")


def test_the_robot_s_own_limits_bind_too():
    own = JointLimits(limits(torque_nm=1000.0, joint_speed_rad_s=10.0), subject().model)
    assert own.torque_nm.max() == 40.0
    assert own.speed_rad_s.max() == pytest.approx(0.1745, abs=1e-4)


def test_a_pose_of_another_arm_and_an_empty_range_are_refused():
    with pytest.raises(ConfigError, match="start_rad"):
        JointLimits(limits(start_rad=(0.0,)), subject().model)
    with pytest.raises(ConfigError, match="joint_range_margin_rad"):
        JointLimits(limits(joint_range_margin_rad=4.0), subject().model)


def test_a_robot_that_slides_needs_its_limits_in_metres(tmp_path):
    model = RobotModel(sliding_urdf(tmp_path), "tool")
    with pytest.raises(ConfigError, match=r"^sliding: missing; 'joint4' is prismatic"):
        JointLimits(limits(), model)
    sliding = {"range_margin_m": 0.1, "speed_m_s": 0.1, "acceleration_m_s2": 0.2, "force_n": 5.0}
    own = JointLimits(limits(sliding=sliding | {"jerk_m_s3": 0.7}), model)
    assert own.units == ("rad",) * 3 + ("m",) + ("rad",) * 3
    found = (own.speed_rad_s, own.acceleration_rad_s2, own.jerk_rad_s3, own.torque_nm)
    assert [values[3] for values in found] == [0.1, 0.2, 0.7, 5.0]
    assert own.acceleration_rad_s2[0] == limits().joint_acceleration_rad_s2
    assert own.upper_rad[3] == pytest.approx(model.model.upperPositionLimit[10] - 0.1)
    with pytest.raises(
        ConfigError, match=r"^sliding.range_margin_m: 9 leaves no range to 'joint4'"
    ):
        JointLimits(limits(sliding=sliding | {"range_margin_m": 9.0}), model)
