"""A URDF becomes the model it describes, or a clear error."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from hil.world.links import Body
from hil.world.robot import Robot
from tests.support.truth_cases import (
    BODIES,
    TWO_ARMS,
    URDF,
    pin_model,
    random_arm,
    random_urdf,
)


def test_stand_in_has_the_published_masses_and_limits() -> None:
    robot = Robot.load(URDF, "tool")
    assert robot.joint_names == tuple(f"joint{i}" for i in range(1, 8))
    masses = robot.model.body_mass[1:]
    assert masses[0] == 1000.0
    assert masses[1:].sum() == pytest.approx(28.3, abs=1e-9)
    assert np.allclose(np.rad2deg(robot.upper_rad), [170, 120] * 3 + [170])
    assert np.allclose(robot.lower_rad, -robot.upper_rad)
    assert np.allclose(robot.effort_nm, 40.0)
    assert np.allclose(np.rad2deg(robot.speed_rad_s), 10.0)
    p, R = robot.tool_poses(np.zeros((1, 7)))
    assert np.allclose(p[0], [0.0, 0.0, 2.97])
    assert np.allclose(R[0], np.eye(3))


def test_a_base_is_the_root_with_all_that_is_fixed_to_it(tmp_path: Path) -> None:
    """A mast and a box on it, as `bodies.base` of the flight software has it."""
    parts = "".join(
        f'<link name="{name}"><inertial><mass value="{kg}"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="to_{name}" type="fixed"><parent link="{parent}"/><child link="{name}"/>'
        '<origin xyz="0 0 1"/></joint>'
        for name, parent, kg in (("mast", "{root}", 4.0), ("box", "mast", 2.0))
    )
    text = URDF.read_text(encoding="utf-8")
    root = pin.buildModelFromXML(text, pin.JointModelFreeFlyer()).frames[2].name
    path = tmp_path / "robot.urdf"
    path.write_text(text.replace("</robot>", parts.replace("{root}", root) + "</robot>"))
    base = Body(100.0, (0.0, 0.0, 0.1), (20.0, 0.0, 0.0, 20.0, 0.0, 20.0))
    assert Robot.load(path, "tool").model.body_subtreemass[1] == pytest.approx(1034.3)
    assert Robot.load(path, "tool", base).model.body_subtreemass[1] == pytest.approx(128.3)


def test_tool_pose_agrees_with_another_engine(tmp_path: Path) -> None:
    case = random_arm(tmp_path)
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (20, 3))
    p, R = case.robot.tool_poses(q)
    data = case.model.createData()
    for k in range(len(q)):
        pose = np.concatenate([np.zeros(6), [1.0], q[k]])
        pin.forwardKinematics(case.model, data, pose)
        frame = pin.updateFramePlacement(case.model, data, case.model.getFrameId("tool"))
        assert np.abs(p[k] - frame.translation).max() <= 1e-12
        assert np.abs(R[k] - frame.rotation).max() <= 1e-12


def test_joints_of_several_arms_are_in_the_order_of_another_engine(tmp_path: Path) -> None:
    """Whatever order the file has its arms and links in."""
    text = TWO_ARMS.read_text(encoding="utf-8")
    text = text.replace('"left_link', '"z_link').replace('"right_joint', '"a_joint')
    path = tmp_path / "arms.urdf"
    path.write_text(text, encoding="utf-8")
    robot = Robot.load(path, "left_tool")
    model = pin_model(path, None)
    assert robot.joint_names == tuple(model.names[2:])
    hinges = [k for k in range(robot.model.njnt) if robot.model.joint(k).type[0] == 3]
    assert robot.joint_names == tuple(robot.model.joint(k).name for k in hinges)
    assert robot.joint_names[0] == "a_joint1"
    assert np.allclose(robot.mount_p_BM_B_m, 0.0)  # of the arm that grasps
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (5, 14))
    p, R = robot.tool_poses(q)
    data = model.createData()
    for k in range(len(q)):
        pin.forwardKinematics(model, data, np.concatenate([np.zeros(6), [1.0], q[k]]))
        frame = pin.updateFramePlacement(model, data, model.getFrameId("left_tool"))
        assert np.abs(p[k] - frame.translation).max() <= 1e-12
        assert np.abs(R[k] - frame.rotation).max() <= 1e-12


def test_target_and_base_override_enter_the_model() -> None:
    other = Body(310.0, (0.1, 0.2, 0.3), (50.0, 1.0, 2.0, 60.0, -1.0, 40.0))
    robot = Robot.load(URDF, "tool", base=other, target=BODIES["target_leo"])
    assert robot.model.body("base").mass[0] == 310.0
    assert np.allclose(robot.model.body("base").ipos, other.com_m)
    assert robot.model.body("grasped target").mass[0] == 400.0
    assert robot.model.body_mass.sum() == pytest.approx(310.0 + 28.3 + 400.0)


def test_base_without_inertial_data_needs_an_override(tmp_path: Path) -> None:
    path = tmp_path / "bare.urdf"
    text = random_urdf(np.random.default_rng(0))
    start = text.index("<inertial>", text.index('<link name="bus">'))
    stop = text.index("</inertial>", start) + len("</inertial>")
    path.write_text(text[:start] + text[stop:], encoding="utf-8")
    with pytest.raises(ValueError, match="'bus' has no inertial data"):
        Robot.load(path, "tool")
    robot = Robot.load(path, "tool", base=BODIES["base"])
    assert robot.model.body("bus").mass[0] == 1000.0


def test_continuous_joint_has_no_range(tmp_path: Path) -> None:
    robot = random_arm(tmp_path).robot
    assert np.array_equal(np.isinf(robot.upper_rad), [False, True, False])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('type="continuous"', 'type="planar"', "elbow.*planar"),
        ('<link name="tool"/>', '<link name="tool"/><link name="lost"/>', "one root link"),
        ('<joint name="grip"', '<joint name="hold"', "no frame 'grip'"),
    ],
)
def test_an_unsuitable_urdf_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = random_urdf(np.random.default_rng(0))
    assert old in text
    path = tmp_path / "wrong.urdf"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        Robot.load(path, "grip" if "hold" in new else "tool")


def test_a_tool_that_no_joint_moves_is_refused() -> None:
    with pytest.raises(ValueError, match="no joint moves 'base'"):
        Robot.load(URDF, "base")
