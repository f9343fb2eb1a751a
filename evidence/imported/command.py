"""`hil imported`: tables of a bench arm, imported and identified, with and without a wrist."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evidence import runner
from evidence.imported.case import MOTIONS, SENSORS, Case, work
from evidence.store import Store
from evidence.terminal import WRONG, judged, print_table
from hil.judge import chi_square

DOF = 4  # mass and first moments: poses show nothing of the inertia
SIGMAS = 5.0  # beyond this a mass is wrong
TITLES = ("motion", "sensors", "valid", "mean NEES of 4", "95 % band", "mass, error and sigma [kg]")


def imported(
    motions: Sequence[str], seeds: Sequence[int], jobs: int, out: Path | None
) -> list[dict[str, Any]]:
    """Run the cases that the folder lacks; return the rows of the summary of all cases.

    Raises
    ------
    ScenarioError if the folder holds results of another study, or an import fails.
    """
    kinds = [(motion, sensors) for motion in motions or MOTIONS for sensors in SENSORS]
    cases = [Case(*kind, seed) for kind in kinds for seed in seeds]
    store = Store(out, {"imported": "a bench arm with 5 kg"})
    runner.rows("imported", work, cases, store, jobs)
    found = [
        _summary(kind, [store.rows[str(Case(*kind, seed))] for seed in seeds]) for kind in kinds
    ]
    for row in found:
        alone = next(r for r in found if r["motion"] == row["motion"] and r["sensors"] == "joints")
        is_better = row["mass_sigma_kg"] <= alone["mass_sigma_kg"]
        row["passed"] &= row["sensors"] != "both" or is_better
    return found


def _summary(kind: tuple[str, str], rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    low, high = chi_square.mean_ends(DOF, len(rows))
    nees = float(np.mean([row["nees"] for row in rows]))
    error, sigma = (
        np.array([row[key] for row in rows]) for key in ("mass_error_kg", "mass_sigma_kg")
    )
    moving = kind[0] == "moving"
    valid = sum(row["status"] == "OK" for row in rows)
    return {
        "motion": kind[0],
        "sensors": kind[1],
        "seeds": len(rows),
        "valid": valid,
        "mean_nees": nees,
        "band_95": [low, high],
        "mass_rms_error_kg": float(np.sqrt(np.mean(error**2))),
        "mass_sigma_kg": float(np.sqrt(np.mean(sigma**2))),
        "passed": bool(
            low <= nees <= high
            and np.all(np.abs(error) < SIGMAS * sigma)
            and (valid == len(rows) or not moving)
        ),
    }


def show(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the table."""
    lines = [
        [
            *(row["motion"], row["sensors"], f"{row['valid']} of {row['seeds']}"),
            f"{row['mean_nees']:.2f}",
            "[{:.2f}, {:.2f}]".format(*row["band_95"]),
            f"{row['mass_rms_error_kg']:.2g} +- {row['mass_sigma_kg']:.2g}",
        ]
        for row in rows
    ]
    print_table("a bench arm that holds 5 kg, from tables", TITLES, lines, 110, WRONG)


def run(
    *, motion: Sequence[str], first: int, count: int, jobs: int, out: Path | None, as_json: bool
) -> int:
    """Print the summary; return the exit code, 0 if every row passed."""
    rows = imported(motion, range(first, first + count), jobs, out)
    return judged(rows, show, as_json=as_json)
