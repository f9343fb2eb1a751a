"""A made-up run as the pictures and pages of the bench show it."""

import numpy as np

from hil.judge.endeffector import ToolError
from hil.judge.report import Point, Residuals, Story

TRUTH = np.arange(1.0, 11.0)


def story(bodies, count):
    points = [
        Point(
            t_s=0.4 * k,
            valid=k > 3,
            reports=dict.fromkeys(bodies, TRUTH * (1 + 0.3 / (k + 1))),
            sigmas=dict.fromkeys(bodies, TRUTH * 0.1 / (k + 1)),
            information_nats=float(k),
        )
        for k in range(count)
    ]
    error = ToolError(
        t_s=np.linspace(0, 60, 5), position_m=np.zeros((1, 5)), angle_rad=np.full((1, 5), 1e-3)
    )
    return Story(
        title="test",
        truth=dict.fromkeys(bodies, TRUTH),
        points=points,
        residuals=Residuals(t_s=np.arange(4.0), torque_nm=np.zeros((4, 3))),
        tool_errors={"prior": error, "estimate": error},
    )
