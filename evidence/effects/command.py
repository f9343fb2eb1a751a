"""`hil study effects`: many seeds of a servicer's scenarios from samples, against their bounds.

All seeds have the same truth. A seed draws noise, offsets, biases, and the errors of the bodies'
priors. With the declared sigmas it also draws the errors of the wheels' inertias, the thrusters'
forces, delays and rise times, and mass, frequency and damping of every mode. The momentum in the
wheels (6 N m s, 1 sigma 10 N m s per axis) is not drawn, and modes are at rest at the start.
"""

import sys
from collections.abc import Sequence
from typing import Unpack

import numpy as np

from evidence.effects.case import Case, work
from evidence.experiment import Experiment, Kind, Line, Over
from evidence.methods.statistics import ratio
from evidence.store import Row
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


def announced(chosen: Sequence[str], seeds: int, runs: int) -> str:
    """Return a text that says how many runs are needed and how many are stored."""
    scenarios = f"{len(chosen)} scenarios ({', '.join(chosen)}), {seeds} seeds each"
    stored = len(chosen) * seeds - runs
    return f"study effects: {runs} runs: {scenarios}; {stored} are stored; see docs/study.md"


def summary(rows: Sequence[Row], outside: float = 0.05) -> Line:
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


def _cells(row: Line) -> list[str]:
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


def _summary(kind: Kind, rows: Sequence[Row]) -> list[Line]:
    return [{"scenario": kind[0]} | summary(rows)]


STUDY = Experiment(
    name="effects",
    settings={"effects": "samples"},
    case=Case,
    work=work,
    summary=_summary,
    title="effects of a servicer from samples, every state of its configuration",
    columns=TITLES,
    cells=_cells,
    width=170,
)


def run(*, scenarios: Sequence[str], **over: Unpack[Over]) -> int:
    """Print how many runs there are, then the summary; return 0 if every row passed, else 1."""
    chosen = list(scenarios or SCENARIOS)
    kinds, seeds = [(name,) for name in chosen], range(over["first"], over["first"] + over["count"])
    missing = STUDY.missing(kinds, seeds, over["out"])
    sys.stderr.write(f"hil: {announced(chosen, len(seeds), len(missing))}\n")
    return STUDY.run(kinds, over)
