"""The search is repeatable, keeps the limits in the truth, and its light model is right."""

from pathlib import Path

import numpy as np
import pytest

from hil import shrink
from hil.excitation import probe, subject
from hil.world.limits import Limits, check, worst
from hil.world.spline import JointSpline
from hil.world.truth import Robot, simulate
from tests.support.truth_cases import BODIES, URDF, stand_in


@pytest.mark.parametrize("name", ["target_leo", "target_geo"])
def test_light_model_uses_as_much_of_the_limits_as_the_truth(name: str) -> None:
    case = stand_in(name)
    light = subject(URDF, "tool", BODIES[name], ("base", "target"))
    seen = probe(light, case.spline, Limits())
    _, first = worst(check(case.robot, simulate(case.robot, case.spline, 0.0, 20.0)))
    assert seen.ratio == pytest.approx(first.ratio, rel=0.05)  # coarse steps miss a peak


def test_information_grows_with_the_motion() -> None:
    spline = stand_in(None).spline
    light = subject(URDF, "tool", None, ("base",))
    small = probe(light, spline.scaled(0.3), Limits()).information_nats
    assert 0.0 < small < probe(light, spline, Limits()).information_nats


def test_search_is_repeatable_and_its_result_keeps_the_limits(tmp_path: Path) -> None:
    options = ["--system", "target_leo", "--seed", "5", "--candidates", "8", "--changes", "4"]
    for name in ("a.yaml", "b.yaml"):
        assert shrink.main([str(tmp_path / name), *options]) == 0
    a, b = (JointSpline.load(tmp_path / name) for name in ("a.yaml", "b.yaml"))
    assert np.array_equal(a.control_points_rad, b.control_points_rad)
    robot = Robot.load(URDF, "tool", target=BODIES["target_leo"])
    checks = check(robot, simulate(robot, a, 0.0, 60.0))
    assert all(entry.ok for entry in checks.values())
