"""Noise-free samples of a case: a simulation of the stored identification motion."""

from functools import lru_cache

import numpy as np

from evidence.methods.cases import DURATION_S, RATE_HZ, scenario_of
from hil.judge.endeffector import Verification
from hil.judge.floating import FloatingRobot
from hil.world.history import TruthState
from hil.world.inertia import FloatArray, pi_of
from hil.world.links import Body
from hil.world.robot import Robot
from hil.world.scenario import Scenario
from hil.world.spline import JointSpline
from hil.world.truth import simulate

STEPS_PER_SAMPLE = 2  # integration steps; every sample is at a step, so nothing is interpolated


@lru_cache(maxsize=3)
def exact_samples(case: str) -> TruthState:
    """Return the true states at 100 Hz over the motion, at most 60 s, as arrays (N, ...)."""
    scenario = scenario_of(case)
    spline = JointSpline.load(scenario.identification)
    end_s = min(DURATION_S, spline.duration_s)
    step_s = 1.0 / (RATE_HZ * STEPS_PER_SAMPLE)
    history = simulate(true_robot(scenario), spline, 0.0, end_s, step_s, stand=scenario.stand)
    return history.at(np.arange(round(end_s * RATE_HZ)) / RATE_HZ)


def true_robot(scenario: Scenario) -> Robot:
    """Return the scenario's robot with its true bodies."""
    bodies = {name: _body(report) for name, report in scenario.truth.items()}
    base, target = bodies["base"], bodies.get("target")
    return Robot.load(
        scenario.urdf, scenario.tool_frame, base, target, scenario.slosh, panels=scenario.panels
    )


def verification(scenario: Scenario) -> Verification:
    """Return the motion of a scenario on which the tool's error is predicted."""
    pis = {body: pi_of(report) for body, report in scenario.truth.items()}
    robot = FloatingRobot(scenario.urdf, scenario.tool_frame, pis, scenario.unknown)
    spline = JointSpline.load(scenario.verification)
    return Verification(robot, lambda t: spline.evaluate(t)[:2], spline.duration_s)


def base_velocity(state: TruthState) -> FloatArray:
    """Return v_NB_B (N, 3) [m/s], the velocity of the base origin in B."""
    v: FloatArray = np.einsum("kji,kj->ki", state.R_NB, state.v_NB_N)
    return v


def _body(report: FloatArray) -> Body:
    mass, cx, cy, cz, xx, xy, xz, yy, yz, zz = (float(x) for x in report)
    return Body(mass, (cx, cy, cz), (xx, xy, xz, yy, yz, zz))
