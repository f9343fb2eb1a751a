"""What a scene draws: volumes, and boxes with the inertia of their body, in closed form."""

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hil
from fsw.errors import ConfigError
from fsw.estimators.model.robot import RobotModel
from offline.view import shapes
from offline.view.shapes import ball, box_of, capsules, hull, reach_m, visuals
from tests.conftest import arm_urdf

SIZE_M = np.array([0.2, 0.4, 1.0])
VISUALS = """
<visual><origin xyz="1 0 0"/><geometry><box size="0.2 0.4 1.0"/></geometry></visual>
<visual><geometry><sphere radius="0.1"/></geometry></visual>
<visual><geometry><cylinder radius="0.1" length="0.5"/></geometry></visual>
<visual><geometry><mesh filename="{mesh}" scale="2 2 2"/></geometry>
<material name="red"><color rgba="1 0 0 0.5"/></material></visual>
"""


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the volume inside faces that turn counter-clockwise from outside."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def tetrahedron(path) -> None:
    """Write a binary STL of unit legs: a sixth of a cubic metre."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    rows = [struct.pack("<12fH", 0, 0, 0, *corners[list(face)].ravel(), 0) for face in faces]
    path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + b"".join(rows))


def test_a_box_has_mass_inertia_and_place_of_its_body():
    R, mass, com = Rotation.from_rotvec([0.3, -0.7, 1.1]).as_matrix(), 12.0, np.array([1, 2, 3.0])
    squares = SIZE_M**2
    inertia = R @ np.diag(mass / 12.0 * (squares.sum() - squares)) @ R.T
    corners = box_of(mass, com, inertia[np.triu_indices(3)])
    assert corners.mean(axis=0) == pytest.approx(com)
    along = np.ptp((corners - com) @ R, axis=0)
    assert along == pytest.approx(SIZE_M)
    assert volume(*hull(corners - com)) == pytest.approx(SIZE_M.prod())


def test_a_ball_is_round_and_a_capsule_joins_two():
    radius = 0.3
    points = ball(radius)
    assert np.linalg.norm(points, axis=1) == pytest.approx(radius)
    sphere = 4.0 / 3.0 * np.pi * radius**3
    assert volume(*hull(points)) == pytest.approx(sphere, rel=0.06)
    both = np.concatenate([points, points + np.array([0, 0, 1.0])])
    assert volume(*hull(both)) == pytest.approx(sphere + np.pi * radius**2, rel=0.04)


def test_visual_shapes_of_the_urdf_are_drawn_and_a_mesh_in_its_scale(tmp_path, monkeypatch):
    tetrahedron(tmp_path / "part.stl")
    drawn = VISUALS.format(mesh=tmp_path / "part.stl")
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(arm_urdf(3).replace('<link name="link2">', f'<link name="link2">{drawn}'))
    model = RobotModel(urdf, "gripper")
    found = visuals(model, urdf)
    assert [shape.frame for shape in found] == [2] * 4
    volumes = [volume(shape.vertices_m, shape.faces) for shape in found]
    assert volumes[0] == pytest.approx(SIZE_M.prod())
    assert found[0].vertices_m.mean(axis=0) == pytest.approx([1, 0, 0])
    assert volumes[1:3] == pytest.approx([4 / 3 * np.pi * 1e-3, np.pi * 0.01 * 0.5], rel=0.06)
    assert volumes[3] == pytest.approx(8.0 / 6.0)
    assert (found[3].colour, found[3].opacity) == ("#ff0000", pytest.approx(0.5))
    monkeypatch.setattr(shapes, "MOST_TRIANGLES", 3)
    assert volume(visuals(model, urdf)[3].vertices_m, visuals(model, urdf)[3].faces) > 1.3
    (tmp_path / "part.stl").unlink()
    with pytest.raises(ConfigError, match=r"visual geometry.*part\.stl"):
        visuals(model, urdf)


def test_the_reach_is_that_of_the_longest_arm():
    urdf = Path(hil.__file__).parent / "robots" / "two_arm_satellite.urdf"
    model = RobotModel(urdf, "left_tool")
    steps_m = dict(zip(model.joint_names, model.steps_m(), strict=True))
    left_m, right_m = (
        sum(step for name, step in steps_m.items() if name.startswith(side))
        for side in ("left", "right")
    )
    tool = model.model.frames[model.model.getFrameId("left_tool")].placement.translation
    expected = max(left_m + np.linalg.norm(tool), right_m)
    assert reach_m(model, "left_tool") == pytest.approx(expected)


def test_without_visual_shapes_every_step_is_a_capsule(tmp_path):
    (tmp_path / "arm.urdf").write_text(arm_urdf(3))
    model = RobotModel(tmp_path / "arm.urdf", "gripper")
    assert visuals(model, tmp_path / "arm.urdf") == []
    assert reach_m(model, "gripper") == pytest.approx(3 * 0.4 + 0.3)
    found = capsules(model, "gripper")
    assert [shape.frame for shape in found] == [0, 1, 2, 3]
    for shape, length_m in zip(found, [0.4, 0.4, 0.4, 0.3], strict=True):
        thick = np.ptp(shape.vertices_m[:, 0])
        assert np.ptp(shape.vertices_m[:, 2]) == pytest.approx(length_m + thick)
