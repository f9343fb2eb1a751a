"""The picture of a run: convergence with bands, torque residuals, tool error, information."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.judge.endeffector import ToolError
from hil.world.inertia import COUNT, LABELS, FloatArray

if TYPE_CHECKING:  # otherwise imported when a picture is drawn
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BAND_SIGMAS = 3.0
COLUMNS = 5
WIDTH_IN, ROW_IN = 16.0, 2.5
BODY_ROWS = COUNT // COLUMNS
TRUTH, ESTIMATE, PRIOR = "#202020", "#1f5fa8", "#9a9a9a"  # colours of the page


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Point:
    """One published estimate; reports and sigmas (10,) per unknown body."""

    t_s: float  # time after the motion's start
    valid: bool
    reports: Mapping[str, FloatArray]
    sigmas: Mapping[str, FloatArray]
    information_nats: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Residuals:
    """Measured minus predicted joint torque at the final estimate."""

    t_s: FloatArray  # (k,)
    torque_nm: FloatArray  # (k, n)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Story:
    """The data of the picture."""

    title: str
    truth: Mapping[str, FloatArray]
    points: Sequence[Point]
    residuals: Residuals
    tool_errors: Mapping[str, ToolError]  # by name; row 0 is drawn


def draw(story: Story) -> Figure:
    """Return the figure: ten panels per unknown body, then residuals, tool error, information."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    bodies = list(story.truth)
    rows = BODY_ROWS * len(bodies) + 2
    height_in = ROW_IN * rows
    figure = Figure(figsize=(WIDTH_IN, height_in))
    FigureCanvasAgg(figure)
    figure.suptitle(story.title, y=1.0 - 0.1 / height_in, verticalalignment="top")
    low, high = 0.55 / height_in, 1.0 - 0.6 / height_in  # a layout engine would draw twice
    grid = figure.add_gridspec(
        rows, COLUMNS, left=0.05, right=0.99, bottom=low, top=high, wspace=0.35, hspace=0.5
    )
    for k, body in enumerate(bodies):
        for j in range(COUNT):
            spot = grid[BODY_ROWS * k + j // COLUMNS, j % COLUMNS]
            _convergence(figure.add_subplot(spot), story, body, j)
    _residuals(figure.add_subplot(grid[-2, :3]), story.residuals)
    _information(figure.add_subplot(grid[-2, 3:]), story.points)
    left, right = figure.add_subplot(grid[-1, :3]), figure.add_subplot(grid[-1, 3:])
    _tool(left, story.tool_errors, "position_m", "tool position error [m]")
    _tool(right, story.tool_errors, "angle_rad", "tool angle error [rad]")
    return figure


def save(story: Story, path: Path) -> Path:
    """Draw and write a PNG; return its path."""
    draw(story).savefig(path, dpi=90)
    return path


def _convergence(axes: Axes, story: Story, body: str, index: int) -> None:
    t = np.array([point.t_s for point in story.points])
    values = np.array([point.reports[body][index] for point in story.points])
    sigma = np.array([point.sigmas[body][index] for point in story.points])
    truth = float(story.truth[body][index])
    axes.axhline(truth, color=TRUTH, linewidth=1.0)
    if len(t):
        low, high = values - BAND_SIGMAS * sigma, values + BAND_SIGMAS * sigma
        axes.fill_between(t, low, high, color=ESTIMATE, alpha=0.25, linewidth=0)
        axes.plot(t, values, color=ESTIMATE, linewidth=1.0)
        half = _half_range(t, np.abs(values - truth) + BAND_SIGMAS * sigma)
        axes.set_ylim(truth - half, truth + half)
    unit = "kg" if index == 0 else "m" if index < 4 else "kg m²"
    axes.set_title(f"{body} {LABELS[index]} [{unit}], ±{BAND_SIGMAS:.0f} sigma", fontsize=8)
    axes.set_ylabel(f"{LABELS[index]} [{unit}]", fontsize=7)
    axes.set_xlabel("time [s]", fontsize=7)
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.tick_params(labelsize=7)


def _half_range(t: FloatArray, distance: FloatArray) -> float:
    """Return half the axis range: the last two thirds of the run fit, the start may not."""
    late = distance[t >= t[0] + (t[-1] - t[0]) / 3]
    half = float(np.percentile(late[np.isfinite(late)], 95)) if np.isfinite(late).any() else 1.0
    return 1.1 * half or 1.0


def _residuals(axes: Axes, residuals: Residuals) -> None:
    for joint in range(residuals.torque_nm.shape[1]):
        axes.plot(
            residuals.t_s, residuals.torque_nm[:, joint], ".", markersize=2, label=f"J{joint + 1}"
        )
    axes.set_title("joint torque, measured minus predicted", fontsize=9)
    axes.set_ylabel("torque [N m]")
    axes.set_xlabel("time [s]")
    axes.legend(fontsize=6, ncols=4, loc="upper right")


def _information(axes: Axes, points: Sequence[Point]) -> None:
    axes.plot([p.t_s for p in points], [p.information_nats for p in points], color=ESTIMATE)
    axes.set_title("information gained about the bodies", fontsize=9)
    axes.set_ylabel("gained [nat]")
    axes.set_xlabel("time [s]")


def _tool(axes: Axes, errors: Mapping[str, ToolError], key: str, title: str) -> None:
    styles = {"prior": PRIOR, "estimate": ESTIMATE}
    for name, error in errors.items():
        values = np.maximum(getattr(error, key)[0], 1e-9)
        axes.semilogy(error.t_s, values, label=name, color=styles.get(name))
    axes.set_title(title.split(" [", maxsplit=1)[0], fontsize=9)
    axes.set_ylabel(title)
    axes.set_xlabel("time on the verification trajectory [s]")
    axes.legend(fontsize=7)
