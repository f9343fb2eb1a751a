"""A collected replay as tables (CSV, Parquet) and a picture, beside the page."""

from __future__ import annotations

import csv
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fsw.commands.identified_body import QUANTITIES
from fsw.commands.parquet import write_parquet
from fsw.commands.report.collect import Collected
from fsw.commands.report.view import Chart, View
from fsw.exchange.status import body_sigma, body_values
from fsw.messages.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ESTIMATE = "Estimate over time"


class Table(NamedTuple):
    """Rows under the names of their columns; floats keep every digit."""

    head: list[str]
    rows: list[list[Any]]


def tables(collected: Collected) -> dict[str, Table]:
    """Return `estimate`, `residuals` (where there is a state to predict from) and `events`.

    Times are seconds from the start of what was replayed.
    """
    start_ns = collected.result.start_ns

    def seconds(t_ns: int) -> float:
        return round((t_ns - start_ns) * 1e-9, 6)

    bodies = [f"{body}_{name}" for body in collected.result.unknown for name in QUANTITIES]
    head = ["t_s", "valid", "reason", "nis", "nis_dof"]
    head += [*bodies, *(f"{name}_sigma" for name in bodies)]
    rows = [
        [seconds(e.t_ns), int(e.valid), e.reason, e.nis, e.nis_dof]
        + [x for b in e.bodies.values() for x in _flat(body_values(b).values())]
        + [x for b in e.bodies.values() for x in _flat(body_sigma(b).values())]
        for e in collected.estimates
    ]
    found = {"estimate": Table(head, rows)}
    r = collected.residuals
    if r is not None:
        units = [f"{n} [{u}]" for n, u in zip(r.names, r.units, strict=True)]
        head = ["t_s", *units, *(f"{name} sigma" for name in units)]
        values = zip(r.t_ns.tolist(), r.value.tolist(), r.sigma.tolist(), strict=True)
        found["residuals"] = Table(head, [[seconds(t), *value, *sig] for t, value, sig in values])
    events = [[seconds(e.t_ns), e.severity, e.code, e.text] for e in collected.result.events]
    return found | {"events": Table(["t_s", "severity", "code", "text"], events)}


def _flat(values: Iterable[object]) -> list[float]:
    return [float(x) for value in values for x in np.atleast_1d(np.asarray(value))]


def write_tables(collected: Collected, stem: Path, kinds: Collection[str]) -> list[Path]:
    """Write STEM_NAME.csv, STEM_NAME.parquet or both of every table; return what was written.

    Raises
    ------
    ConfigError without pyarrow; OSError when a file cannot be written.
    """
    written = []
    for name, table in tables(collected).items() if kinds else ():
        for kind in kinds:
            written.append(stem.with_name(f"{stem.name}_{name}.{kind}"))
            if kind == "csv":
                _write_csv(table, written[-1])
            else:
                columns = zip(*table.rows, strict=True) if table.rows else ([] for _ in table.head)
                write_parquet(written[-1], dict(zip(table.head, columns, strict=True)))
    return written


def _write_csv(table: Table, path: Path) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(table.head)
        writer.writerows(table.rows)


def write_png(view: View, path: Path) -> None:
    """Draw the charts of the estimate over time.

    Raises
    ------
    ConfigError without matplotlib.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        words = "--png needs matplotlib: pip install 'inertia-daemon[excite]'"
        raise ConfigError(words) from error
    charts = next(section.charts for section in view.sections if section.title == ESTIMATE)
    rows = max(1, -(-len(charts) // 2))
    figure = Figure(figsize=(14, 4 * rows), layout="constrained")
    figure.suptitle(f"{view.title}: {view.verdict}")
    axes = np.atleast_1d(figure.subplots(rows, 2, squeeze=False)).ravel()
    for axis, chart in zip(axes, charts, strict=False):
        _draw(axis, chart)
    for axis in axes[len(charts) :]:
        axis.set_visible(False)
    figure.savefig(path, dpi=100)


def _draw(axis: Axes, chart: Chart) -> None:
    for line in chart.lines:
        (drawn,) = axis.plot(chart.x, _array(line.y), label=line.label, linewidth=1)
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
