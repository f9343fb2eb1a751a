"""`hil calibration`: run many seeds of every scenario and summarise the errors of the figures."""

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np
from scipy.stats import norm

from evidence.calibration.case import BOUND_SIGMAS, KINDS, Case, work
from evidence.experiment import Experiment, Kind, Line, Over
from evidence.store import Row

TITLES = (
    *("scenario", "mode", "figure", "unit", "measured", "refused", "median sigma"),
    *("rms [sigma]", "worst [sigma]", "beyond"),
)


def summary(kind: Kind, rows: Sequence[Row]) -> list[Line]:
    """Return the errors over all seeds of a scenario and mode, one line for each kind of figure."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for figure in (figure for row in rows for figure in row["figures"]):
        name = figure["name"].partition(".")[0]
        groups.setdefault(figure["name"] if name == "delay" else name, []).append(figure)
    return [
        {"scenario": kind[0], "mode": kind[1], "kind": name, **_row(own)}
        for name, own in groups.items()
    ]


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
        "beyond": (beyond := int(np.count_nonzero(off > BOUND_SIGMAS))),
        "passed": not beyond,
    }


def note(rows: Sequence[Line]) -> str:
    """Return how many figures are beyond the bound, and how many should be by chance."""
    measured, beyond = (sum(row[key] for row in rows) for key in ("measured", "beyond"))
    by_chance = measured * 2.0 * norm.sf(BOUND_SIGMAS)
    return (
        f"{measured} figures measured, {beyond} of them beyond {BOUND_SIGMAS:g} sigma; "
        f"of as many Gaussian ones {by_chance:.1f} would be"
    )


def _cells(row: Line) -> list[str]:
    numbers = [row[key] for key in ("median_sigma", "rms_sigmas", "worst_sigmas")]
    return [
        *(str(row[key]) for key in ("scenario", "mode", "kind", "unit", "measured", "refused")),
        *("" if number is None else f"{number:.3g}" for number in numbers),
        str(row["beyond"]),
    ]


STUDY = Experiment(
    name="calibration",
    settings={"calibration": "wrong sensors"},
    case=Case,
    work=work,
    summary=summary,
    title=f"fsw calibrate, bound {BOUND_SIGMAS:g} sigma",
    columns=TITLES,
    cells=_cells,
    width=120,
    note=note,
)


def run(*, scenario: Sequence[str], **over: Unpack[Over]) -> int:
    """Print the summary; return the exit code, 1 if a figure is beyond its bound."""
    return STUDY.run([kind for kind in KINDS if not scenario or kind[0] in scenario], over)
