"""A campaign as one page like that of `fsw report`: verdict, NEES, errors over sigma, bad runs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.stats import chi2

from evidence.campaign.config import Campaign
from evidence.campaign.summary import ERRORS
from fsw.estimators.model.inertia import NAMES
from hil.world.scenario import load
from offline.report.channel_sections import normalised_chart
from offline.report.collect import versions
from offline.report.page import page
from offline.report.picture import write_png
from offline.report.tables import Table as Rows
from offline.report.tables import write_csv
from offline.report.view import Chart, Line, Section, Table, View, numbers

UNITS = ("kg", *("kg m",) * 3, *("kg m²",) * 6)
SINGLE = (0.025, 0.975)  # quantiles of the band of one run's NEES
OUTLIER = 0.999  # a run whose NEES is beyond this quantile is a bad run
MOST_BAD = 50  # largest number of bad runs that are shown
Row = Mapping[str, Any]


def write_page(
    rows: Sequence[Row], entries: Sequence[Row], campaign: Campaign, out: Path
) -> tuple[Path, ...]:
    """Write the page `out`, a picture (PNG) and a table (CSV) in its folder; return the paths.

    Parameters
    ----------
    rows, entries : the runs, and the summary of each group of runs
    """
    shown = view(rows, entries, campaign, out.parent.name)
    out.write_text(page(shown), encoding="utf-8")
    charts = [chart for section in shown.sections for chart in section.charts]
    picture, table = out.with_suffix(".png"), out.with_suffix(".csv")
    write_png(shown, charts, picture)
    write_csv(_table(rows), table)
    return out, picture, table


def view(rows: Sequence[Row], entries: Sequence[Row], campaign: Campaign, name: str) -> View:
    """Return the page of a campaign."""
    faults = [fault for entry in entries for fault in _faults(entry)]
    valid = sum(row["status"] == "OK" for row in rows)
    words = f"CONSISTENT: {valid} of {len(rows)} runs valid, every mean NEES in its 95 % band"
    return View(
        title=f"{name}: campaign of {len(rows)} runs, {campaign.level} level",
        verdict=words if not faults else f"NOT CONSISTENT: {'; '.join(faults)}",
        valid=not faults,
        sections=[
            _overview(entries),
            _bad(rows),
            *(_group(entry, _of(rows, entry)) for entry in entries if "nees" in entry),
            _timing(rows),
            Section(
                title="Configuration and versions",
                tables=[Table(head=("item", "value"), rows=list(versions().items()))],
                source=yaml.safe_dump(campaign.model_dump(mode="json")),
            ),
        ],
    )


def _name(entry: Row) -> str:
    motion = Path(entry["trajectory"]).stem
    return f"{Path(entry['scenario']).stem}, {entry['noise']}" + (f", {motion}" if motion else "")


def _faults(entry: Row) -> list[str]:
    counts = {"failed": entry["failed"], "not valid": entry["not_valid"]}
    found = [f"{count} {word}" for word, count in counts.items() if count]
    if "nees" in entry:
        low, high = entry["nees_band"]
        if not low <= entry["nees"] <= high:
            found.append(f"mean NEES {entry['nees']:.2f} not in [{low:.2f}, {high:.2f}]")
    return [f"{fault} ({_name(entry)})" for fault in found]


def _of(rows: Sequence[Row], entry: Row) -> list[Row]:
    """Return the valid runs of a group."""
    keys = ("scenario", "noise", "trajectory")
    return [r for r in rows if r["status"] == "OK" and all(r[k] == entry[k] for k in keys)]


def _overview(entries: Sequence[Row]) -> Section:
    table = []
    for entry in entries:
        counts = [str(entry[key]) for key in ("runs", "failed", "not_valid")]
        judged = ["-"] * (2 + len(ERRORS))
        if "nees" in entry:
            low, high = entry["nees_band"]
            means = [entry[name] for name in ERRORS]
            judged = [
                f"{entry['nees']:.2f} for {entry['dof']}",
                f"[{low:.2f}, {high:.2f}]",
                *(f"{one['mean']:.3g} +- {one['half_interval']:.2g}" for one in means),
            ]
        table.append((_name(entry), *counts, *judged))
    tool = ("mean tool error [m]", "largest [m]", "mean angle [rad]", "largest [rad]")
    head = ("runs of", "runs", "failed", "not valid", "mean NEES", "95 % band", *tool)
    text = ["NEES is the normalised estimation error squared, its mean the number of parameters."]
    return Section(title="Result", text=text, tables=[Table(head=head, rows=table)])


def _bad(rows: Sequence[Row]) -> Section:
    """Return the section of runs that failed, are not valid or have a high NEES, worst first."""
    found = []
    for row in rows:
        if row["status"] != "OK" or row["nees"] > chi2.ppf(OUTLIER, len(row["error"])):
            nees, worst = "-", "-"
            if row.get("error"):
                ratio = np.array(row["error"]) / np.array(row["sigma"])
                k = int(np.argmax(np.abs(ratio)))
                nees = f"{row['nees']:.1f}"
                worst = f"{_parameters(row['scenario'])[k]} {ratio[k]:+.1f} sigma"
            said = (row["traceback"].strip().splitlines() or [""])[-1]
            told = (str(row["seed"]), _name(row), row["status"], nees, worst, said)
            found.append((-row.get("nees", np.inf), told))
    found.sort()
    text = [
        f"{len(found)} of {len(rows)} runs failed, are not valid, or have a NEES beyond the "
        f"{100 * OUTLIER:g} % quantile; {min(len(found), MOST_BAD)} shown."
    ]
    head = ("seed", "run of", "status", "NEES", "farthest off", "error")
    table = Table(head=head, rows=[told for _, told in found[:MOST_BAD]])
    return Section(title="Bad runs", text=text, tables=[table])


def _timing(rows: Sequence[Row]) -> Section:
    wall_s = np.array([row["wall_s"] for row in rows if "wall_s" in row])
    text = "No run has ended."
    if len(wall_s):
        text = (
            f"A run took {np.median(wall_s):.3g} s (median), the longest {wall_s.max():.3g} s, "
            f"all together {wall_s.sum():.3g} s."
        )
    return Section(title="Timing", text=[text])


def _parameters(scenario: str) -> list[str]:
    return [f"{body}.{name}" for body in load(scenario).unknown for name in NAMES]


def _group(entry: Row, rows: Sequence[Row]) -> Section:
    """Return the section of a group: NEES of the runs, errors over sigma, and efficiency."""
    rows = sorted(rows, key=lambda row: int(row["seed"]))
    names = _parameters(entry["scenario"])
    error, sigma = (np.array([row[key] for row in rows]) for key in ("error", "sigma"))
    seeds, ratio, nees = [row["seed"] for row in rows], error / sigma, [r["nees"] for r in rows]
    low, high = (float(chi2.ppf(p, entry["dof"])) for p in SINGLE)
    name, x_label = _name(entry), "seed [1]"
    bands = {"expected": entry["dof"], "2.5 %": low, "97.5 %": high}
    charts = [
        Chart(
            title=f"{name}: NEES of each run",
            y_label="NEES [1]",
            lines=[
                Line(label="run", y=nees, points=True),
                *(Line(label=word, y=[float(y)] * len(rows)) for word, y in bands.items()),
            ],
            x_label=x_label,
            x=seeds,
        ),
        Chart(
            title=f"{name}: errors of each run over their sigma",
            y_label="error / sigma [1]",
            lines=[
                *(
                    Line(label=word, y=numbers(ratio[:, k]), points=True)
                    for k, word in enumerate(names)
                ),
                *(Line(label=f"{y:+g} sigma", y=[y] * len(rows)) for y in (-3.0, 3.0)),
            ],
            x_label=x_label,
            x=seeds,
        ),
        normalised_chart(
            f"{name}: error / sigma of all parameters", "error / sigma [1]", ratio.ravel()
        ),
    ]
    rms = np.sqrt(np.mean(error**2, axis=0))
    table = [
        (f"{word} [{UNITS[k % len(UNITS)]}]", f"{rms[k]:.3g}", f"{sigma[:, k].mean():.3g}",
         f"{np.sqrt(np.mean(ratio[:, k] ** 2)):.2f}", f"{entry['efficiency'][k]:.2f}",
         f"[{entry['efficiency_low'][k]:.2f}, {entry['efficiency_high'][k]:.2f}]")
        for k, word in enumerate(names)
    ]  # fmt: skip
    head = ("parameter", "rms error", "mean sigma", "rms of error / sigma", "efficiency", "95 %")
    text = [
        "Moments about the origin of the body's frame. Efficiency is the mean variance that was "
        "stated over the mean square error."
    ]
    tables = [Table(head=head, rows=table)]
    return Section(title=name, text=text, tables=tables, charts=charts, in_rows_of=3)


def _table(rows: Sequence[Row]) -> Rows:
    """Return the runs as a table with columns for the error and the sigma of every parameter."""
    plain = ("key", "seed", "scenario", "noise", "trajectory", "status", "nees", *ERRORS, "wall_s")
    count = max((len(row.get("error", ())) for row in rows), default=0)
    lists = [(key, k) for key in ("error", "sigma") for k in range(count)]
    head = [*plain, *(f"{key}_{NAMES[k % 10]}_{k // 10}" for key, k in lists)]
    table = []
    for row in rows:
        held = [row[key][k] if k < len(row.get(key, ())) else "" for key, k in lists]
        table.append([*(row.get(key, "") for key in plain), *held])
    return Rows(head, lambda: iter(table))
