"""`hil rough`: many seeds of a rough world, declared or undeclared, and of an ideal world."""

from collections.abc import Sequence
from typing import Unpack

import numpy as np

from evidence.experiment import Experiment, Kind, Line, Over
from evidence.mistakes.command import CASES
from evidence.rough.case import ROUGH, Case, work
from evidence.store import Row
from hil.judge import chi_square

TITLES = (
    *("unknown", "told", "valid", "wrong", "mean NEES", "95 % band"),
    *("mass, rms error and sigma [kg]", ""),
)
NOT_JUDGED = "undeclared"  # is not judged by NEES, only by valid and wrong outputs
DOUBTED = ("terms", "defaults")  # declare errors that the ideal world lacks: sigma is too large


def _summary(kind: Kind, rows: Sequence[Row]) -> list[Line]:
    """Return the figures over all seeds; the 95 % band holds for a mean of chi-square values."""
    (unknown, told), count, dof = kind, len(rows), rows[0]["dof"]
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
    line = {
        "unknown": unknown,
        "told": told,
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
    return [line]


def _cells(row: Line) -> list[str]:
    low, high = row["band_95"]
    masses = row["mass_rms_error_and_sigma_kg"].items()
    return [
        *(row["unknown"], row["told"], f"{row['valid']} of {row['seeds']}", str(row["wrong"])),
        *(f"{row['mean_nees']:.2f}", f"[{low:.2f}, {high:.2f}]"),
        ", ".join(f"{body} {error:.3g} +- {sigma:.3g}" for body, (error, sigma) in masses),
        "ok" if row["passed"] else "FAILED",
    ]


STUDY = Experiment(
    name="rough",
    settings={"rough": "friction, links, coloured torque noise"},
    case=Case,
    work=work,
    summary=_summary,
    title="friction, wrong links and coloured torque noise, or none of them",
    columns=TITLES,
    cells=_cells,
)


def run(*, case: Sequence[str], told: Sequence[str], **over: Unpack[Over]) -> int:
    """Print the summary; return the exit code, 0 if every row passed."""
    return STUDY.run([(name, kind) for kind in told or ROUGH for name in case or CASES], over)
