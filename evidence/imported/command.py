"""`hil imported`: tables of a bench arm, imported and identified, with and without a wrist."""

from collections.abc import Sequence
from typing import Unpack

import numpy as np

from evidence.experiment import Experiment, Kind, Line, Over
from evidence.imported.case import MOTIONS, SENSORS, Case, work
from evidence.store import Row
from hil.judge import chi_square

DOF = 4  # mass and first moments: poses show nothing of the inertia
SIGMAS = 5.0  # beyond this a mass is wrong
TITLES = ("motion", "sensors", "valid", "mean NEES of 4", "95 % band", "mass, error and sigma [kg]")


def _summary(kind: Kind, rows: Sequence[Row]) -> list[Line]:
    low, high = chi_square.mean_ends(DOF, len(rows))
    nees = float(np.mean([row["nees"] for row in rows]))
    error, sigma = (
        np.array([row[key] for row in rows]) for key in ("mass_error_kg", "mass_sigma_kg")
    )
    moving = kind[0] == "moving"
    valid = sum(row["status"] == "OK" for row in rows)
    line = {
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
    return [line]


def _cells(row: Line) -> list[str]:
    return [
        *(row["motion"], row["sensors"], f"{row['valid']} of {row['seeds']}"),
        f"{row['mean_nees']:.2f}",
        "[{:.2f}, {:.2f}]".format(*row["band_95"]),
        f"{row['mass_rms_error_kg']:.2g} +- {row['mass_sigma_kg']:.2g}",
    ]


STUDY = Experiment(
    name="imported",
    settings={"imported": "a bench arm with 5 kg"},
    case=Case,
    work=work,
    summary=_summary,
    title="a bench arm that holds 5 kg, from tables",
    columns=TITLES,
    cells=_cells,
    width=110,
)


def run(*, motion: Sequence[str], **over: Unpack[Over]) -> int:
    """Print the summary; return the exit code, 0 if every row passed.

    A wrist beside the joints must not make the mass less known than the joints alone.
    """
    kinds = [(name, sensors) for name in motion or MOTIONS for sensors in SENSORS]
    seeds = range(over["first"], over["first"] + over["count"])
    found = STUDY.lines(kinds, seeds, over["jobs"], over["out"])
    for row in found:
        alone = next(r for r in found if r["motion"] == row["motion"] and r["sensors"] == "joints")
        is_better = row["mass_sigma_kg"] <= alone["mass_sigma_kg"]
        row["passed"] &= row["sensors"] != "both" or is_better
    return STUDY.judged(found, as_json=over["as_json"])
