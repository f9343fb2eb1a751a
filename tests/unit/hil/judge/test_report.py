"""The picture of a run exists for one body and for two, and survives a run without estimates."""

import numpy as np
import pytest

from hil.judge.endeffector import ToolError
from hil.judge.report import Point, Residuals, Story, draw, save
from hil.world.inertia import COUNT

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


@pytest.mark.parametrize("bodies", [("target",), ("base", "target")])
def test_there_is_a_panel_for_every_parameter(bodies):
    figure = draw(story(bodies, 8))
    titles = [axes.get_title() for axes in figure.axes]
    for body in bodies:
        assert sum(title.startswith(body + " ") for title in titles) == COUNT
    assert len(titles) == COUNT * len(bodies) + 4


def test_the_truth_lies_in_the_shown_range():
    panels = draw(story(("target",), 8)).axes[:COUNT]
    for value, axes in zip(TRUTH, panels, strict=True):
        low, high = axes.get_ylim()
        assert low < value < high


def test_a_run_without_estimates_is_still_drawn(tmp_path):
    path = save(story(("target",), 0), tmp_path / "run.png")
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
