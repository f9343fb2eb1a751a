"""Sudden motion against finite differences and what each kind is meant to do."""

import numpy as np
import pytest

from hil.world.scenario import ScenarioError, changed, load
from hil.world.spline import JointSpline
from hil.world.sudden import Chatter, Steps, Stop, SuddenMotion

STEP_S = 1e-4
POINTS = np.array([0.0] * 4 + [0.5, 1.5, -1.0] + [0.8] * 4)[:, None] * [1.0, -0.5]
PLANNED = JointSpline(20.0, POINTS)
KINDS = [Stop(at_s=7.0), Steps(), Chatter(from_s=3.0, to_s=15.0)]


@pytest.mark.parametrize("sudden", KINDS, ids=lambda own: own.kind)
def test_rates_and_accelerations_are_finite_differences(sudden):
    motion = SuddenMotion(PLANNED, sudden)
    t = np.linspace(0.1, motion.duration_s - 0.1, 4001)
    q, qd, qdd = motion.evaluate(t)
    before, after = (motion.evaluate(t + way * STEP_S) for way in (-1, 1))
    np.testing.assert_allclose((after[0] - before[0]) / (2 * STEP_S), qd, atol=1e-5)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * STEP_S), qdd, atol=2e-3)
    assert q.shape == (4001, 2)


@pytest.mark.parametrize("sudden", KINDS, ids=lambda own: own.kind)
def test_the_motion_ends_where_it_was_planned_to(sudden):
    motion = SuddenMotion(PLANNED, sudden)
    q, qd, qdd = motion.evaluate(motion.duration_s)
    np.testing.assert_allclose(q, PLANNED.evaluate(20.0)[0], atol=1e-9)
    assert np.abs(qd).max() == np.abs(qdd).max() == 0.0


def test_a_stop_holds_the_arm_for_its_time_and_goes_on():
    motion = SuddenMotion(PLANNED, Stop(at_s=7.0, in_s=0.1, for_s=2.0))
    held = motion.evaluate(np.linspace(7.1, 9.1, 50))
    assert max(np.abs(held[1]).max(), np.abs(held[2]).max()) < 1e-20
    assert np.abs(motion.evaluate(7.0)[1]).max() > 0.1
    assert motion.duration_s == pytest.approx(22.1)
    np.testing.assert_allclose(motion.evaluate(12.1)[0], PLANNED.evaluate(10.0)[0])


def test_steps_come_to_rest_in_every_period():
    motion = SuddenMotion(PLANNED, Steps(period_s=0.5))
    q, qd, _ = motion.evaluate(0.5 * np.arange(2, 38))
    assert np.abs(qd).max() < 1e-9
    np.testing.assert_allclose(q, PLANNED.evaluate(0.5 * np.arange(2, 38))[0])


def test_a_scenario_names_what_happens_in_its_motion():
    scenario = load("target_leo")
    found = changed(scenario, ["trajectories.sudden={kind: stop, at_s: 20}"])
    assert found.sudden == Stop(at_s=20.0)
    with pytest.raises(ScenarioError, match=r"trajectories.*sudden"):
        changed(scenario, ["trajectories.sudden={kind: jump}"])
