"""What moves the base beside the arm, found in the simulated truth, against its causes."""

import numpy as np
import pytest

from hil.judge.applied import applied_in, doubts_of
from hil.judge.floating import FloatingRobot
from hil.judge.score import stacked
from hil.run.bench import robot_of, truth_of
from hil.run.motions import motion_of
from hil.world.inertia import pi_of
from hil.world.scenario import load

WRENCH = np.repeat([0.02, 0.02], 3)  # [N, N m]: the truth's step of 4 ms at the edges of a firing
MOMENTUM = np.repeat([0.01, 0.01], 3)  # [N s, N m s]


def found(name: str):
    """Return the state, what acts by the bodies' motion, and the shares of its causes."""
    scenario = load(name)
    robot = robot_of(scenario)
    history = truth_of(scenario, robot, motion_of(scenario, robot))
    state = history.at(np.arange(0.013, 50.0, 0.5))
    pis = {body: pi_of(report) for body, report in scenario.truth.items()}
    judged = FloatingRobot(scenario.urdf, scenario.tool_frame, pis, scenario.unknown)
    applied = applied_in(judged, stacked(scenario.truth, scenario.unknown), state)
    doubts = doubts_of(scenario.wheels, scenario.thrusters, history, state)
    return state, applied, doubts


def test_jets_give_the_wrench_and_the_momentum_that_the_bodies_have():
    _, applied, (together, *each) = found("mev")
    assert np.abs(together.wrench).max() > 10.0
    assert np.abs(together.momentum).max() > 10.0
    wrench, momentum = (np.stack(part) for part in zip(*applied, strict=True))
    steady = np.all(np.abs(together.wrench - wrench) < WRENCH, axis=1)
    assert np.mean(steady) > 0.9, "but for instants within the rise of a force"
    assert np.all(np.abs(together.momentum - momentum) < MOMENTUM)
    np.testing.assert_allclose(sum(one.wrench for one in each), together.wrench, atol=1e-9)


def test_wheels_give_the_wrench_that_the_bodies_have_and_keep_the_whole_momentum():
    state, applied, doubts = found("wheels_leo")
    wrench, momentum = (np.stack(part) for part in zip(*applied, strict=True))
    assert np.abs(wrench).max() > 0.1
    assert np.all(np.abs(sum(one.wrench for one in doubts) - wrench) < WRENCH)
    rotors = -sum(one.momentum for one in doubts)[:, 3:]
    whole_N = np.einsum("kij,kj->ki", state.R_NB, momentum[:, 3:] + rotors)
    assert np.linalg.norm(whole_N[0]) > 1.0
    assert np.all(np.ptp(whole_N, axis=0) < 2 * MOMENTUM[3:])


@pytest.mark.parametrize("name", ["target_leo", "tumbling_target"])
def test_nothing_acts_where_only_the_arm_moves(name):
    state, applied, doubts = found(name)
    assert doubts == []
    wrench, momentum = (np.stack(part) for part in zip(*applied, strict=True))
    assert np.all(np.abs(wrench) < WRENCH)
    whole_N = np.einsum("kij,kj->ki", state.R_NB, momentum[:, 3:])
    assert np.all(np.ptp(whole_N, axis=0) < 2 * MOMENTUM[3:])
