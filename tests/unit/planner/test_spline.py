"""Trajectories: rest to rest, the bench's file format, what a closed one is."""

import numpy as np
import pytest

from fsw.errors import ConfigError
from hil.world.spline import JointSpline
from planner import spline
from planner.verify import free_layout
from tests.support.excitation_cases import SHORT, motion


def test_a_saved_trajectory_is_the_bench_s_motion(tmp_path):
    own = SHORT.trajectory(motion())
    path = tmp_path / "t.yaml"
    spline.save(own, path, {"made": "here"})
    bench, t_s = JointSpline.load(path), np.linspace(0.0, 12.0, 97)[1:-1]
    for found, expected in zip(bench.evaluate(t_s), own.evaluate(t_s)[:3], strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_array_equal(spline.load(path).points_rad, own.points_rad)


def test_it_starts_and_ends_at_rest_without_jerk():
    ends = SHORT.trajectory(motion()).evaluate(np.array([0.0, 12.0]))
    for derivative in ends[1:]:
        np.testing.assert_allclose(derivative, 0.0, atol=1e-12)


def test_jerk_is_continuous_over_the_knots():
    own = SHORT.trajectory(motion())
    knots = np.arange(1, 6) * 2.0
    before, after = own.evaluate(knots - 1e-9)[3], own.evaluate(knots + 1e-9)[3]
    np.testing.assert_allclose(before, after, atol=1e-6)


def test_a_closed_one_ends_where_it_starts():
    layout = spline.SplineLayout(duration_s=12.0, intervals=6, n=7, closed=True)
    q = layout.trajectory(motion(layout)).evaluate(np.array([0.0, 12.0]))[0]
    np.testing.assert_allclose(q[0], q[1], atol=1e-12)


def test_layout_and_variables_are_found_again():
    own = SHORT.trajectory(motion())
    layout, z = free_layout(own)
    np.testing.assert_allclose(layout.trajectory(z).points_rad, own.points_rad)
    np.testing.assert_allclose(z, motion())


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("degree: 3\n", "degree: 5"),
        ("degree: 5\nduration_s: 2\n", "control_points_rad"),
        ("degree: 5\nduration_s: x\ncontrol_points_rad: [[1]]\n", "control_points_rad"),
        ("degree: 5\nduration_s: 2\ncontrol_points_rad: [[1],[2]]\n", "shape"),
        (
            "degree: 5\nduration_s: 2\ncontrol_points_rad: [[1],[2],[1],[1],[1],[1],[1],[1]]\n",
            "rest to rest",
        ),
        ("[", "cannot be read"),
    ],
)
def test_a_wrong_file_is_refused_by_name(tmp_path, text, word):
    path = tmp_path / "t.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=word):
        spline.load(path)
