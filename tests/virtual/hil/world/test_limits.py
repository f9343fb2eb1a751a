"""Every stored motion keeps every limit in the truth and comes close to one."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from hil.world.limits import Limits, check, rotation_angles, worst
from hil.world.spline import JointSpline
from hil.world.truth import Robot, simulate
from tests.support.truth_cases import BODIES, URDF, stand_in

TRAJECTORIES = Path(__file__).parents[4] / "hil" / "trajectories"
STORED = [
    (system, kind)
    for system in ("base", "target_leo", "target_geo")
    for kind in ("identification", "verification")
]


@pytest.mark.parametrize(("system", "kind"), STORED)
def test_stored_motion_keeps_every_limit_and_nearly_touches_one(system: str, kind: str) -> None:
    spline = JointSpline.load(TRAJECTORIES / f"{system}_{kind}.yaml")
    robot = Robot.load(URDF, "tool", target=BODIES.get(system) if system != "base" else None)
    assert spline.duration_s == 60.0
    checks = check(robot, simulate(robot, spline, 0.0, 60.0))
    assert all(entry.ok for entry in checks.values()), checks
    name, first = worst(checks)
    assert 0.95 <= first.ratio <= 0.98, name


def test_every_limit_is_seen_when_broken() -> None:
    case = stand_in("target_leo")
    history = simulate(case.robot, case.spline, 0.0, 20.0, 0.01)
    wide = check(case.robot, history, Limits(*[1e3] * 7, tool_distance_m=1e-3))
    assert {"joint_effort_ratio", "joint_range_ratio", "tool_height_m"} < wide.keys()
    assert all(wide[field.name].ok for field in dataclasses.fields(Limits))
    for field in dataclasses.fields(Limits):
        small = 1e-6 if field.name != "tool_distance_m" else 1e3
        tight = check(case.robot, history, dataclasses.replace(Limits(), **{field.name: small}))
        assert not tight[field.name].ok
        assert tight[field.name].ratio > 1.0


def test_joint_range_effort_and_height_are_seen_when_broken() -> None:
    case = stand_in(None)
    weak = dataclasses.replace(
        case.robot,
        effort_nm=np.full(7, 1e-3),
        upper_rad=np.full(7, 0.1),
        mount_p_BM_B_m=np.array([0.0, 0.0, 5.0]),
    )
    history = simulate(case.robot, case.spline, 0.0, 20.0, 0.01)
    checks = check(weak, history)
    for name in ("joint_effort_ratio", "joint_range_ratio", "tool_height_m"):
        assert not checks[name].ok


def test_rotation_angle_is_exact_from_zero_to_half_a_turn() -> None:
    angles = np.array([0.0, 1e-9, 0.1, 1.5, 3.1])
    c, s, zero, one = np.cos(angles), np.sin(angles), 0 * angles, 0 * angles + 1
    R = np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
    assert np.allclose(rotation_angles(R), angles, rtol=1e-12, atol=0.0)
