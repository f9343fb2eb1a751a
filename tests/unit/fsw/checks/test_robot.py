"""Robot files: one line for every fault, and bodies that no robot can have."""

import re

import pytest

from fsw.checks.configuration import validate
from fsw.config import load
from tests.support.check_cases import assert_named, fault


def test_a_missing_robot_file_is_named(arm):
    arm.data["robot"]["urdf"] = "none.urdf"
    assert_named(fault(arm), "robot.urdf", str(arm.folder / "none.urdf"), "No such file")


@pytest.mark.parametrize("text", ["", "links: 3", "<robot><link/>", "<sdf/>"])
def test_a_robot_file_that_is_no_urdf_is_one_line(arm, text, capfd):
    arm.urdf = text
    message = fault(arm)
    assert_named(message, "robot.urdf", "is not a URDF")
    assert len(message.splitlines()) == 1
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_joint_of_a_kind_that_is_not_known_is_named(arm, kind):
    arm.robot(3, kind)
    assert_named(fault(arm), "robot.urdf", "'axis1'", kind, "revolute, prismatic or fixed")


def test_a_joint_of_another_kind_than_the_urdf_s_is_named(arm):
    arm.robot(3, "prismatic")
    assert_named(fault(arm), "joints.0.kind", "'revolute'", "'axis1' is prismatic")


def test_a_revolute_joint_without_limit_is_named(arm, capfd):
    arm.urdf = re.sub(r"<limit[^>]*>", "", arm.urdf, count=1)
    assert_named(fault(arm), "robot.urdf", "'axis1'", "no <limit>", "effort")
    assert capfd.readouterr().err == ""


BAD_URDF = [
    ('parent link="link2"', 'parent link="nolink"', "nolink"),
    ('mass value="3"', 'mass value="three"', "three"),
    ("</robot>", '<link name="alone"/></robot>', "alone"),
    ('link name="link2"', 'link name="link1"', "link1"),
    ('joint name="axis2"', 'joint name="axis1"', "axis1"),
    ('velocity="0.5"', "", "velocity"),
    ('axis xyz="0 0 1"', 'axis xyz="0 0 0"', "0 0 0"),
    ('axis xyz="0 0 1"', 'axis xyz="z"', "three numbers"),
]


@pytest.mark.parametrize(("good", "bad", "word"), BAD_URDF, ids=[bad for _, bad, _ in BAD_URDF])
def test_what_the_urdf_library_only_prints_is_one_line_here(arm, capfd, good, bad, word):
    arm.urdf = arm.urdf.replace(good, bad, 1)
    message = fault(arm)
    assert_named(message, "robot.urdf", word)
    assert len(message.splitlines()) == 1
    assert capfd.readouterr().err == ""


def test_more_joints_than_the_robot_has_are_listed_on_both_sides(arm):
    arm.robot(2)
    assert_named(fault(arm), "joints", "['axis1', 'axis2', 'axis3']", "2 joints of the robot")


def test_fewer_joints_than_the_robot_has_are_listed_on_both_sides(arm):
    arm.robot(4)
    assert_named(
        fault(arm), "joints", "['axis1', 'axis2', 'axis3']", "4 joints of the robot", "axis4"
    )


def test_a_misspelt_joint_is_listed_on_both_sides(arm):
    arm.data["joints"][1]["name"] = "axis_2"
    assert_named(fault(arm), "joints", "axis_2", "'axis2'")


def test_joints_in_another_order_than_the_robots_are_accepted(arm):
    arm.data["joints"].reverse()
    problem, _ = validate(load(arm.write()))
    assert problem.model.joint_names == ("axis1", "axis2", "axis3")


def test_a_missing_tool_frame_lists_the_frames(arm):
    arm.data["robot"]["tool_frame"] = "hand"
    assert_named(fault(arm), "robot.tool_frame", "'hand'", "gripper", "link3")


def test_a_tool_frame_inside_the_arm_is_refused(arm):
    arm.data["robot"]["tool_frame"] = "link1"
    assert_named(fault(arm), "robot.tool_frame", "'link1'", "last link")


def test_a_massless_root_link_needs_the_base_given(arm):
    arm.urdf = re.sub(r"<inertial>.*?</inertial>", "", arm.urdf, count=1)
    assert_named(fault(arm), "robot.urdf", "root link", "mass 0 kg", "positive, or bodies.base")


def test_a_massless_root_link_serves_when_the_base_is_given(arm):
    arm.urdf = re.sub(r"<inertial>.*?</inertial>", "", arm.urdf, count=1)
    arm.data["bodies"]["base"] = {
        "mass_kg": 200.0,
        "com_m": [0.1, 0.0, -0.3],
        "inertia_kg_m2": [60.0, 0.0, 0.0, 50.0, 0.0, 40.0],
    }
    assert validate(load(arm.write()))[1] == []


def test_a_massless_root_link_has_no_effect_on_a_clamped_base(arm):
    arm.urdf = re.sub(r"<inertial>.*?</inertial>", "", arm.urdf, count=1)
    arm.data["base"] = {"motion": "clamped", "gravity_B_m_s2": [0.0, 0.0, -9.80665]}
    assert validate(load(arm.write()))[1] == []


def test_a_root_link_of_negative_mass_is_refused_on_a_clamped_base(arm):
    arm.urdf = arm.urdf.replace('<mass value="200"/>', '<mass value="-200"/>', 1)
    arm.data["base"] = {"motion": "clamped", "gravity_B_m_s2": [0.0, 0.0, -9.80665]}
    assert_named(fault(arm), "robot.urdf", "root link", "-200 kg")


def test_a_continuous_joint_is_a_revolute_one_without_limits(arm):
    arm.robot(3, "continuous")
    problem, warnings = validate(load(arm.write()))
    assert problem.model.kinds() == ("revolute",) * 3
    assert warnings == []


def test_a_joint_that_mimics_another_says_what_to_do(arm):
    arm.urdf = arm.urdf.replace("<limit", '<mimic joint="axis2"/><limit', 1)
    assert_named(fault(arm), "'axis1' mimics another, 'axis2'", "take <mimic> out", "as fixed")


def test_what_only_a_picture_needs_does_not_matter(arm):
    shape = "<geometry><torus/></geometry><material><color rgba='red'/></material>"
    arm.urdf = arm.urdf.replace("<inertial>", f"<visual>{shape}</visual><inertial>")
    assert validate(load(arm.write()))[1] == []


PLACEHOLDERS = {
    'effort="0"': ('effort="50"', "effort 0 in its <limit>"),
    'velocity="0"': ('velocity="0.5"', "velocity 0 in its <limit>"),
    'effort="1e16"': ('effort="50"', "effort inf"),
    'lower="0" upper="0"': ('lower="-3" upper="3"', "a range of 0 to 0 rad"),
    'lower="-1e5" upper="1e5"': ('lower="-3" upper="3"', "a range of -100000 to 100000 rad"),
    'lower="2" upper="-2"': ('lower="-3" upper="3"', "a range of 2 to -2 rad"),
}


@pytest.mark.parametrize("limit", PLACEHOLDERS)
def test_a_limit_that_no_joint_has_is_a_warning(arm, limit):
    usual, words = PLACEHOLDERS[limit]
    arm.urdf = arm.urdf.replace(usual, limit, 1)
    warnings = validate(load(arm.write()))[1]
    assert len(warnings) == 1
    assert_named(warnings[0], "robot.urdf", "'axis1'", words, "placeholders?")


def test_infinite_limits_of_position_are_none_at_all(arm):
    arm.urdf = arm.urdf.replace('lower="-3" upper="3"', 'lower="-1e16" upper="1e16"', 1)
    problem, warnings = validate(load(arm.write()))
    assert problem.model.model.upperPositionLimit[7] == float("inf")
    assert warnings == []


def test_a_negative_link_mass_is_refused(arm):
    arm.urdf = arm.urdf.replace('<mass value="3"/>', '<mass value="-3"/>', 1)
    assert_named(fault(arm), "robot.urdf", "'axis1'", "-3 kg", "at least 0")


def test_an_inertia_no_body_can_have_is_a_warning(arm):
    arm.urdf = arm.urdf.replace('izz="0.01"', 'izz="0.1"', 1)
    _, warnings = validate(load(arm.write()))
    assert len(warnings) == 1
    assert_named(warnings[0], "robot.urdf", "'axis1'", "sum of the other two")


def test_a_robot_without_joints_is_refused(arm):
    arm.robot(0)
    assert_named(fault(arm), "robot.urdf", "0 joints that move", "the 3 of joints")
