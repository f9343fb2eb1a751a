"""One picture of a trajectory: joints, base, margins to the limits, predicted sigmas over time."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fsw.messages import FloatArray
from planner import attitude
from planner.assess import growth
from planner.collision import Collisions
from planner.design import Grid, LimitRows
from planner.limits import MotionLimits
from planner.spline import Trajectory
from planner.subject import Subject
from planner.verify import free_layout

PICTURE_RATE_HZ = 10.0


def draw(
    subject: Subject,
    limits: MotionLimits,
    collisions: Collisions | None,
    trajectory: Trajectory,
    path: Path,
) -> None:
    """Write a PNG of a trajectory, its base motion, limits and predicted sigmas."""
    layout, z = free_layout(trajectory)
    grid = Grid(layout, PICTURE_RATE_HZ)
    figure = Figure(figsize=(12.0, 13.0), layout="constrained")
    axes = figure.subplots(4, 2)
    angle = "rad or m" if "prismatic" in subject.model.kinds() else "rad"
    units = (f"q [{angle}]", f"qd [{angle}/s]", f"qdd [{angle}/s²]")
    for axis, label, values in zip(axes.flat[:3], units, grid.motion(z), strict=True):
        for name, line in zip(subject.model.joint_names, values, strict=True):
            axis.plot(grid.t_s, line, linewidth=1, label=name)
        axis.set_ylabel(label)
    axes[0, 0].legend(fontsize=7, ncols=4)
    out = _motion(subject, grid, z)
    n = subject.kernel.n
    axes[1, 1].plot(grid.t_s, out[:n].T, linewidth=1)
    axes[1, 1].set_ylabel("joint torque [N m]")
    _base(axes[2, 0], axes[2, 1], grid, out[n : n + 6])
    _shares(axes[3, 0], LimitRows(subject, grid, limits, collisions), z, subject.x)
    _learning(axes[3, 1], subject, trajectory)
    for axis in axes.flat:
        axis.set_xlabel("time [s]")
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def _motion(subject: Subject, grid: Grid, z: FloatArray) -> FloatArray:
    inputs = [*grid.motion(z), np.tile(subject.x[:, None], (1, grid.count))]
    return np.asarray(subject.kernel.motion(*inputs).full())


def _base(turn: Axes, rate: Axes, grid: Grid, motion: FloatArray) -> None:
    phi = attitude.excursions(attitude.attitudes(motion[:3].T, grid.step_s))
    turn.plot(grid.t_s, np.rad2deg(phi), linewidth=1, label=("x", "y", "z"))
    turn.plot(grid.t_s, np.rad2deg(np.linalg.norm(phi, axis=1)), "k", linewidth=1, label="angle")
    turn.set_ylabel("base attitude since the start [deg]")
    turn.legend(fontsize=7)
    for values, label in ((motion[:3], "rate [deg/s]"), (motion[3:], "acceleration [deg/s²]")):
        rate.plot(grid.t_s, np.rad2deg(np.linalg.norm(values, axis=0)), linewidth=1, label=label)
    rate.set_ylabel("base, norm")
    rate.legend(fontsize=7)


def _shares(axis: Axes, rows: LimitRows, z: FloatArray, x: FloatArray) -> None:
    """Plot, per kind of limit, the distance to the bound of the nearest joint, axis or pair."""
    margins: dict[str, FloatArray] = {}
    for row in rows.rows(z, [x]):
        kind = row.kind.split(" ", 1)[0]
        value = np.sqrt(row.value) if row.power == 2 else row.value
        margin = np.minimum(value - row.lower, row.upper - value)
        margins[kind] = np.minimum(margins.get(kind, np.full(len(margin), np.inf)), margin)
    for k, (kind, margin) in enumerate(margins.items()):
        unit = " [m]" if kind.startswith(("tool_", "clearance")) else ""
        style = "-" if k < 10 else "--"  # there are ten colours
        axis.plot(rows.grid.t_s, margin, style, linewidth=1, label=kind + unit)
    axis.axhline(0.0, color="k", linewidth=0.8)
    axis.set_ylim(-0.1, 1.05)
    axis.set_ylabel("margin to the limit, share of it")
    axis.legend(fontsize=6, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def _learning(axis: Axes, subject: Subject, trajectory: Trajectory) -> None:
    grown = growth(subject, trajectory, PICTURE_RATE_HZ)
    shares = grown.sigma / subject.scale.prior_sigma
    for k, name in enumerate(subject.names):
        style = "-" if name.startswith("base") else "--"
        axis.semilogy(grown.t_s, shares[:, k], style, linewidth=1, label=name)
    axis.set_ylabel("predicted sigma / prior sigma")
    axis.legend(fontsize=5, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
