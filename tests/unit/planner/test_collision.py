"""Distances between bodies with collision geometry."""

import numpy as np
import pytest

from evidence.excitation import cases
from fsw.estimators.model.robot import RobotModel
from planner.collision import build_collisions
from planner.limits import TargetBox
from tests.support.excitation_cases import subject

BOX = TargetBox(center_m=(0.0, 0.0, 0.25), size_m=(0.4, 0.4, 0.4))


def with_geometry(tmp_path):
    """Give the paper's arm a slender upper link and its base a plate beside the mount."""
    text = cases.URDF.read_text()
    solid = '<collision><origin xyz="{xyz}"/><geometry><{shape}/></geometry></collision>'
    for link, shape, xyz in (
        ("base", 'box size="2.0 0.5 0.2"', "1.4 0 0"),
        ("link4", 'cylinder radius="0.05" length="0.4"', "0 0 0.25"),
    ):
        text = text.replace(
            f'<link name="{link}">',
            f'<link name="{link}">' + solid.format(shape=shape, xyz=xyz),
        )
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    return path


def collisions(tmp_path):
    path = with_geometry(tmp_path)
    return build_collisions(RobotModel(path, "tool"), path, "tool", BOX)


def test_a_robot_without_geometry_has_nothing_to_check():
    own = subject().model
    assert build_collisions(own, cases.URDF, "tool", None) is None


def test_neighbours_are_left_out_and_pairs_are_named(tmp_path):
    names = collisions(tmp_path).names
    assert any("base" in name and "target" in name for name in names)
    assert any("link4" in name and "base" in name for name in names)


def test_an_upright_arm_is_clear_and_a_folded_one_is_not(tmp_path):
    own = collisions(tmp_path)
    upright, folded = np.zeros(7), np.array([0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    distance, _ = own.distances(np.stack([upright, folded]))
    assert distance[0].min() > 0.3
    assert distance[1].min() < 0.0


@pytest.mark.parametrize("seed", range(3))
def test_the_gradient_is_that_of_the_distance(tmp_path, seed):
    own = collisions(tmp_path)
    rng = np.random.default_rng(seed)
    q, direction, h = 0.5 * rng.standard_normal(7), rng.standard_normal(7), 1e-2
    distance, slope = own.distances(q[None], derivatives=True)
    above, below = own.distances(np.stack([q + h * direction, q - h * direction]))[0]
    apart = distance[0] > 0.01
    assert apart.any()
    # coal iterates to 1e-6 m: hence the wide step, and the bound its curvature needs
    np.testing.assert_allclose(
        slope[0, apart] @ direction, ((above - below) / (2 * h))[apart], atol=1e-3
    )
