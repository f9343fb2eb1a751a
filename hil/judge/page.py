"""A run as one HTML report, with data that only the bench has: truth, errors, tool error."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.judge.report import BAND_SIGMAS, Story
from hil.judge.score import bound_words, exact_words, nees_words, table, table_header
from hil.world.inertia import LABELS, FloatArray
from offline.report.page import page
from offline.report.tables import Table as Rows
from offline.report.tables import write_csv
from offline.report.view import (
    TIME,
    Chart,
    Line,
    Section,
    Table,
    View,
    line_of,
    thinned_axis,
)

UNITS = ("kg", *("m",) * 3, *("kg m²",) * 6)
SETTLED = 1 / 3  # of a run; the last two thirds set a chart's first range
TOOL = ("mean_position_m", "max_position_m", "mean_angle_rad", "max_angle_rad")


def save(story: Story, outcome: Mapping[str, Any], sections: Sequence[Section], path: Path) -> None:
    """Write the page to `path`, and the estimates to a CSV file of the same name.

    Parameters
    ----------
    sections : the sections of every report, the configuration last
    """
    shown = view(story, outcome, sections)
    path.write_text(page(shown), encoding="utf-8")
    names = [f"{body}_{label}" for body in story.truth for label in LABELS]
    head = ["t_s", "valid", *(f"{n}{end}" for end in ("", "_sigma", "_truth") for n in names)]
    truth = np.concatenate(list(story.truth.values())).tolist()
    rows = [
        [point.t_s, int(point.valid), *_joined(point.reports), *_joined(point.sigmas), *truth]
        for point in story.points
    ]
    write_csv(Rows(head, lambda: iter(rows)), path.with_suffix(".csv"))


def _joined(bodies: Mapping[str, FloatArray]) -> list[float]:
    values: list[float] = np.concatenate(list(bodies.values())).tolist()
    return values


def view(story: Story, outcome: Mapping[str, Any], sections: Sequence[Section]) -> View:
    """Return the page of a run."""
    state = "VALID" if outcome["valid"] else f"NOT VALID: {outcome['reason']}"
    return View(
        title=f"{outcome['scenario']}, seed {outcome['seed']}, {outcome['method']}",
        verdict=f"{state}; {nees_words(outcome)}",
        valid=bool(outcome["valid"]),
        sections=[
            _result(outcome),
            _errors(story),
            _tool(story, outcome),
            *sections[:-1],
            _samples(outcome),
            *sections[-1:],
        ],
    )


def _result(outcome: Mapping[str, Any]) -> Section:
    head = ("body", "quantity", *table_header(outcome)[1:])
    rows = [(body, *line) for body in outcome["unknown"] for line in table(outcome, body)]
    text = [
        f"{body}: sigma of the mass is {bound_words(outcome, body)}." for body in outcome["unknown"]
    ]
    text += exact_words(outcome)
    return Section(title="Result", text=text, tables=[Table(head=head, rows=rows)])


def _errors(story: Story) -> Section:
    t_s = np.array([point.t_s for point in story.points])
    charts = []
    for body, truth in story.truth.items() if len(t_s) else ():
        error = np.array([point.reports[body] for point in story.points]) - truth
        reach = BAND_SIGMAS * np.array([point.sigmas[body] for point in story.points])
        late = slice(int(len(t_s) * SETTLED), None)
        for k, label in enumerate(LABELS):
            low, high = error[:, k] - reach[:, k], error[:, k] + reach[:, k]
            span = float(np.min(low[late])), float(np.max(high[late]))
            x = thinned_axis(t_s)
            charts.append(
                Chart(
                    title=f"{body} {label}: estimate minus truth, with {BAND_SIGMAS:g} sigma",
                    x_label=TIME,
                    y_label=f"error [{UNITS[k]}]",
                    x=x,
                    lines=[
                        line_of("estimate", error[:, k], low, high),
                        Line(label="truth", y=[0.0] * len(x)),
                    ],
                    y_range=span if np.isfinite(span).all() else None,
                )
            )
    text = [
        "Time counts from the start of the motion. The range shown first is that of the last two "
        "thirds; double-click shows all."
    ]
    return Section(title="Estimate over time", text=text, charts=charts, in_rows_of=3)


def _tool(story: Story, outcome: Mapping[str, Any]) -> Section:
    names = {"prior": "ee_error_prior", "estimate": "ee_error", "expected from the covariance":
             "ee_error_expected"}  # fmt: skip
    rows = [(name, *(f"{outcome[key][one]:.3g}" for one in TOOL)) for name, key in names.items()]
    charts = []
    for kind, unit in (("position_m", "m"), ("angle_rad", "rad")):
        t_s = next(iter(story.tool_errors.values())).t_s
        lines = [
            line_of(name, np.maximum(getattr(error, kind)[0], 1e-9))
            for name, error in story.tool_errors.items()
        ]
        charts.append(
            Chart(
                title=f"Tool error in {kind.split('_')[0]}",
                x_label="time on the verification trajectory [s]",
                y_label=f"error [{unit}]",
                x=thinned_axis(t_s),
                lines=lines,
                log=True,
            )
        )
    head = ("tool error of", "mean [m]", "largest [m]", "mean [rad]", "largest [rad]")
    tables = [Table(head=head, rows=rows)]
    return Section(title="Tool on the verification trajectory", tables=tables, charts=charts,
                   in_rows_of=2)  # fmt: skip


def _samples(outcome: Mapping[str, Any]) -> Section:
    words = ("received", "lost", "late", "rejected")
    rows = [(name, *(str(n[word]) for word in words)) for name, n in outcome["samples"].items()]
    windows = [(name, str(count)) for name, count in outcome["windows"].items()]
    text = [
        f"{outcome['slips']} slips; {outcome['simulated_s']:.0f} s of flight took "
        f"{outcome['wall_s']:.1f} s; {outcome['blocks']} windows used, {outcome['gated']} rejected."
    ]
    tables = [
        Table(head=("source", *words), rows=rows),
        Table(head=("windows", "count"), rows=windows),
    ]
    return Section(title="Timing", text=text, tables=tables)
