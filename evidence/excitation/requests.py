"""Requests that the planner must refuse."""

from typing import Any

from evidence.excitation import cases
from planner.request import InfeasibleError, MotionRequest

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
