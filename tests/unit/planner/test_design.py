"""Criterion and limits as functions of the control points: exact gradients, right values."""

import numpy as np
import pytest

from evidence.excitation import cases
from hil.world.limits import Limits as BenchLimits
from hil.world.limits import check
from hil.world.truth import simulate
from planner import criteria
from planner.design import Criterion, Grid, LimitRows
from planner.request import PAPER_GAMMA
from tests.support.excitation_cases import SHORT, limits, motion, subject

RATE_HZ = 2.0


@pytest.mark.parametrize("name", criteria.NAMES)
def test_the_criterion_s_gradient(name):
    criterion = Criterion(subject("both"), Grid(SHORT, RATE_HZ), name, PAPER_GAMMA)
    z, rng = motion(), np.random.default_rng(1)
    direction = rng.standard_normal(z.size)
    value, gradient = criterion.gradient(z)
    errors = []
    for h in (1e-3, 3e-4, 1e-4):
        near = criterion.value(z + h * direction) - criterion.value(z - h * direction)
        far = criterion.value(z + 2 * h * direction) - criterion.value(z - 2 * h * direction)
        errors.append(abs((8 * near - far) / (12 * h) / (gradient @ direction) - 1))
    assert value == criterion.value(z)
    assert min(errors) < 1e-5


def test_members_of_the_prior_set_are_averaged():
    own, grid = subject(), Grid(SHORT, RATE_HZ)
    other = own.x * np.array([1.1, *[1.1] * 9])
    both = Criterion(own, grid, "sigma", PAPER_GAMMA, (other,))
    single = Criterion(own, grid, "sigma", PAPER_GAMMA)
    z = motion()
    assert both.value(z) != single.value(z)
    twice = Criterion(own, grid, "sigma", PAPER_GAMMA, (own.x,))
    np.testing.assert_allclose(twice.gradient(z)[1], single.gradient(z)[1])


def test_the_limits_jacobian():
    own = subject("both")
    rows = LimitRows(own, Grid(SHORT, RATE_HZ), limits(joint_jerk_rad_s3=1.0), None)
    z, h = motion(), 1e-6
    direction = np.random.default_rng(2).standard_normal(z.size)
    above = rows.rows(z + h * direction, [own.x])
    below = rows.rows(z - h * direction, [own.x])
    for row, high, low in zip(rows.rows(z, [own.x], derivatives=True), above, below, strict=True):
        numeric = (high.value - low.value) / (2 * h)
        scale = np.abs(numeric).max()
        np.testing.assert_allclose(row.by_z @ direction, numeric, atol=1e-6 * scale + 1e-8)


def test_the_limits_are_the_bench_s():
    # the bench integrates MuJoCo's dynamics under tracking; both look at the same motion
    own = subject("target")
    gentle = SHORT.trajectory(motion(size_rad=0.1))
    grid = Grid(SHORT, 50.0)
    rows = {
        row.kind: row
        for row in LimitRows(own, grid, limits(), None).rows(motion(size_rad=0.1), [own.x])
    }
    robot, spline = cases.truth("target"), cases.joint_spline(gentle)
    found = check(robot, simulate(robot, spline, 0.0, 12.0, 0.01), BenchLimits())
    torque = max(np.abs(row.value).max() * row.size for k, row in rows.items() if "torque" in k)
    assert torque == pytest.approx(found["torque_nm"].value, rel=2e-3)
    speed = max(np.abs(row.value).max() * row.size for k, row in rows.items() if "speed" in k)
    assert speed == pytest.approx(found["joint_speed_rad_s"].value, rel=2e-3)
    for key, name in (
        ("base_attitude", "attitude_rad"),
        ("base_rate", "base_rate_rad_s"),
        ("base_acceleration", "base_acceleration_rad_s2"),
    ):
        largest = np.sqrt(rows[key].value.max()) * rows[key].size
        assert largest == pytest.approx(found[name].value, rel=5e-3)
    nearest = rows["tool_distance"].value.min()
    assert nearest == pytest.approx(found["tool_distance_m"].value, rel=1e-3)
    lowest = rows["tool_box_z"].value.min()
    assert lowest == pytest.approx(found["tool_height_m"].value, abs=2e-3)
