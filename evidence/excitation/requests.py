"""Requests that the planner must refuse, and one with a wrong prior whose limits must hold."""

from typing import Any

from evidence.excitation import cases
from hil.world.limits import LimitCheck, check, worst
from hil.world.truth import simulate
from planner import limits as flight_limits
from planner.plan import Planner
from planner.request import InfeasibleError, MotionRequest
from planner.subject import build_subject

FOLDED = (0.0, 0.3, 0.0, -2.09, 0.0, 0.0, 0.0)  # the tool is in the sphere about the arm's base
INFEASIBLE: dict[str, dict[str, Any]] = {
    "box out of reach": {"tool_box_m": [[None, None], [None, None], [3.0, None]]},
    "torque bound too low": {
        "torque_nm": 1.0,
        "start_rad": (0.0, 0.5, 0.0, -1.0, 0.0, 0.5, 0.0),
        "end_rad": (0.5, 0.8, 0.0, -1.0, 0.0, 0.5, 0.0),
    },
    "torque bound leaves nothing to learn": {"torque_nm": 1e-6},
    "start pose inside the sphere": {"start_rad": FOLDED},
}


def refusal(changes: dict[str, Any], duration_s: float = 20.0) -> InfeasibleError | None:
    """Return the planner's refusal, or None if the planner wrongly succeeds."""
    try:
        request = MotionRequest(duration_s=duration_s)
        cases.planner(cases.subject("target"), request, changes).plan()
    except InfeasibleError as error:
        return error
    return None


def robust(scale: float, spread: float, draws: int, iterations: int = 40) -> tuple[str, LimitCheck]:
    """Plan a motion for a set of targets about `scale` times the true one; simulate the true one.

    Returns
    -------
    name and use of the most used limit in the simulated truth
    """
    own = build_subject(cases.config("target", scale), spread=spread, draws=draws)
    limits = flight_limits.load(cases.LIMITS)
    plan = Planner(own, limits, None, MotionRequest(iterations=iterations)).plan()
    robot, spline = cases.truth("target"), cases.joint_spline(plan.trajectory)
    return worst(check(robot, simulate(robot, spline, 0.0, spline.duration_s, 0.01)))
