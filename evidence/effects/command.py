"""`hil study effects`: many seeds of a servicer's scenarios from samples, against their bounds.

All seeds have the same truth. A seed draws noise, offsets, biases, and the errors of the bodies'
priors. With the declared sigmas it also draws the errors of the wheels' inertias, the thrusters'
forces, delays and rise times, and mass, frequency and damping of every mode. The momentum in the
wheels (6 N m s, 1 sigma 10 N m s per axis) is not drawn, and modes are at rest at the start.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evidence import runner
from evidence.effects.case import Case, work
from evidence.methods.statistics import ratio
from evidence.store import Row, Store
from evidence.terminal import WRONG, judged, print_table
from hil.judge import chi_square

SCENARIOS = (
    *("wheels_leo", "mev", "panel_leo", "base_slosh"),
    *("dual_arm", "target_contact", "firings_unknown"),
)
LIMIT = 1.1  # largest allowed error over the bound
TITLES = (
    *("scenario", "valid", "wrong", "mean NEES", "95 % band", "worst (seed)"),
    *("error over bound (95 %)", "mass: mean error, scatter, sigma [kg]", ""),
)


def effects(
    scenarios: Sequence[str], seeds: Sequence[int], jobs: int, out: Path | None
) -> list[dict[str, Any]]:
    """Run the cases that the folder lacks; return the summary of every scenario.

    Raises
    ------
    ScenarioError if the folder holds results of another study, or a scenario does not exist.
    """
    chosen = list(scenarios or SCENARIOS)
    cases = [Case(name, seed) for name in chosen for seed in seeds]
    store = Store(out, {"effects": "samples"})
    sys.stderr.write(
        f"hil: {announced(chosen, len(seeds), len(runner.missing(cases, str, store)))}\n"
    )
    runner.rows("effects", work, cases, store, jobs)
    return [
        {"scenario": name} | summary([store.rows[str(Case(name, seed))] for seed in seeds])
        for name in chosen
    ]


def announced(chosen: Sequence[str], seeds: int, runs: int) -> str:
    """Return a text that says how many runs are needed and how many are stored."""
    scenarios = f"{len(chosen)} scenarios ({', '.join(chosen)}), {seeds} seeds each"
    stored = len(chosen) * seeds - runs
    return f"study effects: {runs} runs: {scenarios}; {stored} are stored; see docs/study.md"


def summary(rows: Sequence[Row], outside: float = 0.05) -> dict[str, Any]:
    """Return the figures over all seeds; `outside` is the chance of a false alarm of the NEES."""
    count, dof = len(rows), rows[0]["dof"]
    low, high = chi_square.mean_ends(dof, count, outside)
    nees = float(np.mean([row["nees"] for row in rows]))
    squares = np.array([row["error_over_bound_squared"] for row in rows]) / dof
    error = ratio(squares, dof)
    valid, wrong = (sum(bool(row[key]) for row in rows) for key in ("valid", "wrong"))
    masses = {
        body: [float(f(values[:, k])) for k, f in ((0, np.mean), (0, np.std), (1, np.mean))]
        for body in rows[0]["masses"]
        for values in [np.array([row["masses"][body] for row in rows])]
    }
    worst = int(np.argmax([row["nees"] for row in rows]))
    return {
        "seeds": count,
        "valid": valid,
        "wrong": wrong,
        "mean_nees": nees,
        "band": [low, high],
        "dof": dof,
        "worst_nees": [rows[worst]["seed"], rows[worst]["nees"]],
        "error_over_bound": error.value,
        "interval_95": [error.low, error.high],
        "mass_mean_and_scatter_of_error_and_sigma_kg": masses,
        "invalid": {row["seed"]: row["reason"] for row in rows if not row["valid"]},
        "commits": sorted({row["commit"] for row in rows}),
        "passed": valid == count and not wrong and low <= nees <= high and error.value <= LIMIT,
    }


def show(rows: Sequence[dict[str, Any]]) -> None:
    """Print the table."""
    print_table(
        "effects of a servicer from samples, every state of its configuration",
        TITLES,
        [_line(row) for row in rows],
        170,
        WRONG,
    )


def _line(row: dict[str, Any]) -> list[str]:
    (low, high), (seed, most) = row["band"], row["worst_nees"]
    masses = row["mass_mean_and_scatter_of_error_and_sigma_kg"].items()
    return [
        *(row["scenario"], f"{row['valid']} of {row['seeds']}", str(row["wrong"])),
        *(f"{row['mean_nees']:.2f} for {row['dof']}", f"[{low:.2f}, {high:.2f}]"),
        f"{most:.1f} ({seed})",
        "{:.3f} ({:.3f}-{:.3f})".format(row["error_over_bound"], *row["interval_95"]),
        ", ".join(f"{body} {a:+.3g}, {b:.3g}, {c:.3g}" for body, (a, b, c) in masses),
        "ok" if row["passed"] else "FAILED",
    ]


def run(
    *, scenarios: Sequence[str], first: int, count: int, jobs: int, out: Path | None, as_json: bool
) -> int:
    """Print the summary; return the exit code, 0 if every row passed."""
    rows = effects(scenarios, range(first, first + count), jobs, out)
    return judged(rows, show, as_json=as_json)
