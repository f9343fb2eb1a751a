"""Draw charts of a page as one PNG picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from file_delivery.extras import needs
from fsw.errors import ConfigError
from offline.report.view import Chart, View

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#1f5fa8", "#c4511d", "#2a8050", "#8a3d9c", "#8f7a00", "#3f8c99", "#7a4a2b")
NAMED = {"truth": "#202020", "prior": "#9a9a9a"}  # both as in page.js


def write_png(view: View, charts: Sequence[Chart], path: Path) -> None:
    """Draw `charts` into one PNG file, under the title and verdict of `view`.

    Raises
    ------
    ConfigError if matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ConfigError(needs("--png", "matplotlib")) from error
    rows = max(1, -(-len(charts) // 2))
    figure = Figure(figsize=(14, 4 * rows), layout="constrained")
    figure.suptitle(f"{view.title}: {view.verdict}")
    axes = np.atleast_1d(figure.subplots(rows, 2, squeeze=False)).ravel()
    for axis, chart in zip(axes, charts, strict=False):
        axis.set_prop_cycle(color=COLOURS)
        _draw(axis, chart)
    for axis in axes[len(charts) :]:
        axis.set_visible(False)
    figure.savefig(path, dpi=100)


def _draw(axis: Axes, chart: Chart) -> None:
    if not chart.log:
        axis.ticklabel_format(useOffset=False, style="plain")
    for k, line in enumerate(chart.lines):
        style: dict[str, Any] = {"marker": ".", "linestyle": "none"} if line.points else {}
        if line.label in NAMED:
            style["color"] = NAMED[line.label]
        if chart.bars and k == 0:
            axis.bar(chart.x, _array(line.y), width=0.95 * np.diff(chart.x).mean(), alpha=0.4)
            continue
        (drawn,) = axis.plot(chart.x, _array(line.y), label=line.label, linewidth=1, **style)
        if line.low is not None and line.high is not None:
            low, high = _array(line.low), _array(line.high)
            axis.fill_between(chart.x, low, high, color=drawn.get_color(), alpha=0.2, linewidth=0)
    axis.set(title=chart.title, xlabel=chart.x_label, ylabel=chart.y_label)
    if chart.log:
        axis.set_yscale("log")
    elif chart.y_range is not None:
        axis.set_ylim(*chart.y_range)
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small")


def _array(values: Sequence[float | None]) -> np.ndarray:
    return np.array([np.nan if x is None else x for x in values])
