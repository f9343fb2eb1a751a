"""The picture of a run exists for one body and for two, and survives a run without estimates."""

import pytest

from hil.judge.report import draw, save
from hil.world.inertia import COUNT
from tests.support.stories import TRUTH, story


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
