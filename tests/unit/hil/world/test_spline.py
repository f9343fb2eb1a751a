"""Joint splines rest at both ends, are smooth, and survive a file."""

from pathlib import Path

import numpy as np
import pytest

from hil.world.spline import JointSpline
from tests.support.truth_cases import random_spline


def test_starts_and_ends_at_rest_without_acceleration_and_jerk() -> None:
    spline = random_spline(7, 0)
    for t, pose in ((0.0, 0), (20.0, -1), (-5.0, 0), (30.0, -1)):
        q, qd, qdd = spline.evaluate(t)
        assert np.abs(q - spline.control_points_rad[pose]).max() <= 1e-12
        assert not qd.any()
        assert not qdd.any()
    _, _, near = spline.evaluate([1e-3, 20.0 - 1e-3])
    assert np.abs(near).max() <= 1e-6  # acceleration grows with the square of time: no jerk step


def test_rates_are_derivatives() -> None:
    spline = random_spline(3, 1)
    t, h = np.linspace(0.5, 19.5, 101), 1e-4
    (q0, v0, _), (_, v, a), (q1, v1, _) = (spline.evaluate(t + s) for s in (-h, 0.0, h))
    assert np.abs((q1 - q0) / (2 * h) - v).max() <= 1e-7
    assert np.abs((v1 - v0) / (2 * h) - a).max() <= 1e-7


def test_jerk_is_continuous_at_every_knot() -> None:
    spline = random_spline(2, 2)
    knots = np.arange(0.0, 20.0 + 1e-9, spline.knot_spacing_s)
    h = 1e-4
    jerk = [
        (spline.evaluate(knots + s + h)[2] - spline.evaluate(knots + s)[2]) / h for s in (-h, 0.0)
    ]
    assert np.abs(jerk[1] - jerk[0]).max() <= 1e-3 * np.abs(spline.evaluate(knots)[2]).max()


def test_scaling_is_about_the_start_pose() -> None:
    spline = random_spline(3, 5, 0.7)
    q, _, a = spline.evaluate(9.0)
    half_q, _, half_a = spline.scaled(0.5).evaluate(9.0)
    start = spline.control_points_rad[0]
    assert np.allclose(half_q - start, 0.5 * (q - start))
    assert np.allclose(half_a, 0.5 * a)


def test_file_gives_the_same_motion_bit_for_bit(tmp_path: Path) -> None:
    spline = random_spline(7, 6)
    spline.save(tmp_path / "a.yaml", {"seed": 6})
    again = JointSpline.load(tmp_path / "a.yaml")
    assert again.duration_s == spline.duration_s
    assert np.array_equal(again.control_points_rad, spline.control_points_rad)


@pytest.mark.parametrize(
    "text", ["degree: 3\nduration_s: 1\ncontrol_points_rad: []\n", "degree: 5\n", "[]"]
)
def test_a_file_that_is_no_such_spline_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"a\.yaml"):
        JointSpline.load(path)


def test_motion_that_does_not_rest_at_its_ends_is_refused() -> None:
    points = random_spline(2, 7).control_points_rad.copy()
    points[1] += 0.1
    with pytest.raises(ValueError, match="rest to rest"):
        JointSpline(20.0, points)
    with pytest.raises(ValueError, match="positive"):
        JointSpline(0.0, random_spline(2, 7).control_points_rad)
    with pytest.raises(ValueError, match="shape"):
        JointSpline(1.0, np.zeros((5, 2)))
