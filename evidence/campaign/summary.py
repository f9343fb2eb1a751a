"""Statistics over the runs of a campaign: intervals, consistency, efficiency."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

TABLE = "results.parquet"
CONFIDENCE = 0.95
ERRORS = ("mean_position_m", "max_position_m", "mean_angle_rad", "max_angle_rad")


def summary(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return one entry of statistics for each scenario, noise and trajectory, sorted by these."""
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["scenario"], row["noise"], row["trajectory"]), []).append(row)
    return [_entry(name, own) for name, own in sorted(groups.items())]


def write_table(rows: Sequence[Mapping[str, Any]], folder: Path) -> Path:
    """Write the runs to a Parquet file in the folder, in the order given; return its path."""
    import pyarrow
    from pyarrow import parquet

    path = folder / TABLE
    parquet.write_table(pyarrow.Table.from_pylist(list(rows)), path)
    return path


def _entry(name: tuple[str, str, str], rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    good = [row for row in rows if row["status"] == "OK"]
    entry: dict[str, Any] = {
        "scenario": name[0],
        "noise": name[1],
        "trajectory": name[2],
        "runs": len(rows),
        "failed": sum(row["status"] == "FAILED" for row in rows),
        "not_valid": sum(row["status"] not in ("OK", "FAILED") for row in rows),
    }
    if not good:
        return entry
    error, bound = (np.array([row[k] for row in good]) for k in ("error", "bound"))
    count, dof = error.shape
    ends = np.array([0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2])
    low, high = np.asarray(stats.chi2.ppf(ends, count))
    ratio = np.mean(bound**2, axis=0) / np.mean(error**2, axis=0)
    nees = np.array([row["nees"] for row in good])
    band = np.asarray(stats.chi2.ppf(ends, dof * count)) / count
    return entry | {
        "dof": dof,
        "nees": float(nees.mean()),
        "nees_band": band.tolist(),
        "mean_error": error.mean(axis=0).tolist(),
        "mean_error_half_interval": _half_interval(error).tolist(),
        "efficiency": ratio.tolist(),  # mean square bound over mean square error, per parameter
        "efficiency_low": (ratio * low / count).tolist(),
        "efficiency_high": (ratio * high / count).tolist(),
        **{name: _mean_with_interval([row[name] for row in good]) for name in ERRORS},
    }


def _half_interval(values: np.ndarray) -> np.ndarray:
    """Return half of Student's interval of the mean over the first axis; infinity for one value."""
    count = len(values)
    if count < 2:
        return np.full(values.shape[1:], np.inf)
    factor = stats.t.ppf(0.5 + CONFIDENCE / 2, count - 1)
    return np.asarray(factor * values.std(axis=0, ddof=1) / np.sqrt(count))


def _mean_with_interval(values: Sequence[float]) -> dict[str, float]:
    array = np.array(values)
    return {"mean": float(array.mean()), "half_interval": float(_half_interval(array))}
