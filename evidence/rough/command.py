"""`hil rough`: many seeds of a rough world, declared or undeclared, and of an ideal world."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evidence import runner
from evidence.mistakes.command import CASES
from evidence.rough.case import IDEAL, ROUGH, Case, work
from evidence.store import Row, Store
from evidence.terminal import WRONG, judged, print_table
from hil.judge import chi_square

KINDS = (*ROUGH, *IDEAL)
TITLES = (
    *("unknown", "told", "valid", "wrong", "mean NEES", "95 % band"),
    *("mass, rms error and sigma [kg]", ""),
)
NOT_JUDGED = "undeclared"  # is not judged by NEES, only by valid and wrong outputs
DOUBTED = ("terms", "defaults")  # declare errors that the ideal world lacks: sigma is too large


def rough(
    unknown: Sequence[str], told: Sequence[str], seeds: Sequence[int], jobs: int, out: Path | None
) -> list[dict[str, Any]]:
    """Run the cases that the folder lacks; return the rows of the summary of all cases.

    Raises
    ------
    ScenarioError if the folder holds results of another study.
    """
    chosen = [(name, kind) for kind in told or ROUGH for name in unknown or CASES]
    cases = [Case(name, kind, seed) for name, kind in chosen for seed in seeds]
    store = Store(out, {"rough": "friction, links, coloured torque noise"})
    runner.rows("rough", work, cases, store, jobs)
    return [
        {"unknown": name, "told": kind}
        | _summary(kind, [store.rows[str(Case(name, kind, seed))] for seed in seeds])
        for name, kind in chosen
    ]


def _summary(told: str, rows: Sequence[Row]) -> dict[str, Any]:
    """Return the figures over all seeds; the 95 % band holds for a mean of chi-square values."""
    count, dof = len(rows), rows[0]["dof"]
    low, high = chi_square.mean_ends(dof, count)
    nees = float(np.mean([row["nees"] for row in rows]))
    masses = {
        body: [float(np.sqrt(np.mean(np.square(both[:, k])))) for k in (0, 1)]
        for body in rows[0]["masses"]
        for both in [np.array([row["masses"][body] for row in rows])]
    }
    wrong = sum(row["wrong"] > 0 for row in rows)
    valid = sum(row["valid"] for row in rows)
    above = nees >= low or told in DOUBTED
    within = told == NOT_JUDGED or (above and nees <= high and valid == count)
    return {
        "seeds": count,
        "valid": valid,
        "wrong": wrong,
        "mean_nees": nees,
        "band_95": [low, high],
        "mass_rms_error_and_sigma_kg": masses,
        "reasons": {
            r: sum(row["reason"] == r for row in rows) for r in {x["reason"] for x in rows}
        },
        "passed": wrong == 0 and within,
    }


def show(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the table."""
    print_table(
        "friction, wrong links and coloured torque noise, or none of them",
        TITLES,
        [_line(row) for row in rows],
        130,
        WRONG,
    )


def _line(row: Mapping[str, Any]) -> list[str]:
    low, high = row["band_95"]
    masses = row["mass_rms_error_and_sigma_kg"].items()
    return [
        *(row["unknown"], row["told"], f"{row['valid']} of {row['seeds']}", str(row["wrong"])),
        *(f"{row['mean_nees']:.2f}", f"[{low:.2f}, {high:.2f}]"),
        ", ".join(f"{body} {error:.3g} +- {sigma:.3g}" for body, (error, sigma) in masses),
        "ok" if row["passed"] else "FAILED",
    ]


def run(
    *,
    case: Sequence[str],
    told: Sequence[str],
    first: int,
    count: int,
    jobs: int,
    out: Path | None,
    as_json: bool,
) -> int:
    """Print the summary; return the exit code, 0 if every row passed."""
    rows = rough(case, told, range(first, first + count), jobs, out)
    return judged(rows, show, as_json=as_json)
