"""`hil calibration`: run many seeds of every scenario and summarise the errors of the figures."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from evidence import runner
from evidence.calibration.case import BOUND_SIGMAS, KINDS, Case, work
from evidence.store import Row, Store
from evidence.terminal import print_table

TITLES = (
    *("scenario", "mode", "figure", "unit", "measured", "refused", "median sigma"),
    *("rms [sigma]", "worst [sigma]", "beyond"),
)


def calibration(
    scenarios: Sequence[str], seeds: Sequence[int], jobs: int, out: Path | None
) -> list[dict[str, Any]]:
    """Run the cases that the folder lacks; return the rows of the summary of all cases.

    Raises
    ------
    ScenarioError if the folder holds results of another study.
    """
    chosen = [(name, mode) for name, mode in KINDS if not scenarios or name in scenarios]
    cases = [Case(name, mode, seed) for name, mode in chosen for seed in seeds]
    store = Store(out, {"calibration": "wrong sensors"})
    found = runner.rows("calibration", work, cases, store, jobs)
    return summary(dict(zip(cases, found, strict=True)))


def summary(found: Mapping[Case, Row]) -> list[dict[str, Any]]:
    """Return the errors over all seeds: one row for each scenario, mode and kind of figure."""
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for case, row in found.items():
        for figure in row["figures"]:
            kind = figure["name"].partition(".")[0]
            kind = figure["name"] if kind == "delay" else kind
            groups.setdefault((case.scenario, case.mode, kind), []).append(figure)
    return [{"scenario": s, "mode": m, "kind": k, **_row(own)} for (s, m, k), own in groups.items()]


def _row(figures: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the row of one kind; refused figures are only counted."""
    shown = [figure for figure in figures if figure["verdict"] == "measured"]
    off = np.abs([figure["off_sigmas"] for figure in shown])
    return {
        "unit": figures[0]["unit"],
        "measured": len(shown),
        "refused": len(figures) - len(shown),
        "median_sigma": float(np.median([f["sigma"] for f in shown])) if shown else None,
        "rms_sigmas": float(np.sqrt(np.mean(off**2))) if shown else None,
        "worst_sigmas": float(off.max()) if shown else None,
        "beyond": int(np.count_nonzero(off > BOUND_SIGMAS)),
    }


def show(rows: Sequence[Mapping[str, Any]], seeds: int) -> None:
    """Print the table, and how many figures should be beyond the bound by chance."""
    measured, beyond = (sum(row[key] for row in rows) for key in ("measured", "beyond"))
    by_chance = measured * 2.0 * norm.sf(BOUND_SIGMAS)
    print_table(
        f"fsw calibrate, {seeds} seeds, bound {BOUND_SIGMAS:g} sigma",
        TITLES,
        [_line(row) for row in rows],
        120,
        f"{measured} figures measured, {beyond} of them beyond {BOUND_SIGMAS:g} sigma; "
        f"of as many Gaussian ones {by_chance:.1f} would be",
    )


def _line(row: Mapping[str, Any]) -> list[str]:
    numbers = [row[key] for key in ("median_sigma", "rms_sigmas", "worst_sigmas")]
    return [
        *(str(row[key]) for key in ("scenario", "mode", "kind", "unit", "measured", "refused")),
        *("" if number is None else f"{number:.3g}" for number in numbers),
        str(row["beyond"]),
    ]


def run(
    *, scenario: Sequence[str], first: int, count: int, jobs: int, out: Path | None, as_json: bool
) -> int:
    """Print the summary; return the exit code, 1 if a figure is beyond its bound."""
    rows = calibration(scenario, range(first, first + count), jobs, out)
    if as_json:
        print(json.dumps(rows))
    else:
        show(rows, count)
    return int(any(row["beyond"] for row in rows))
