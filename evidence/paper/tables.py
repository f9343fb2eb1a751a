"""Make tables from results: medians and quartiles by method, verdicts, orders of the methods."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from evidence.paper.cases import ALL, METHODS, NONE, PAPER, PAPER_SEED, SYSTEMS
from evidence.paper.printed import (
    BEST,
    BETTER_BY,
    METRICS,
    PARAMETERS,
    PRINTED,
    TABLE_2,
    TABLE_3,
)
from evidence.paper.run import BIAS, DEVICE, SAMPLE

Results = Mapping[str, Mapping[str, Any]]
EXPECTED = tuple(f"expected_{name}" for name in METRICS)  # from the method's own covariance
BOUND = tuple(f"bound_{name}" for name in METRICS)  # from the Cramer-Rao bound of all samples


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One metric of one method: quartiles over the seeds, and the value of the paper's seed."""

    orbit: str
    system: str
    noise: str
    acting: str
    method: str  # followed by ", device bytes" at device level
    metric: str
    seeds: int
    failed: int
    median: float
    low: float  # quartiles
    high: float
    paper_seed: float
    printed: float | None  # the paper's figure; None if there is none


def cells(results: Results) -> list[Cell]:
    """Return a cell for each metric, case and method, in the order of the results."""
    groups: dict[tuple[str, ...], list[tuple[int, Mapping[str, Any]]]] = {}
    for key, values in results.items():
        level, orbit, system, noise, acting, seed, _ = key.split("|")
        if level == BIAS:
            continue
        for method, found in values.items():
            name = f"{method}, device bytes" if level == DEVICE else method
            group = (orbit, system, noise, acting, name)
            groups.setdefault(group, []).append((int(seed), found))
    table = []
    for (orbit, system, noise, acting, name), own in groups.items():
        compared = (orbit, noise, acting) == ("leo", PAPER, ALL)
        good = [(seed, found) for seed, found in own if METRICS[0] in found]
        for metric in (*METRICS, *EXPECTED, *BOUND, "nees"):
            if metric in BOUND and name != "fused":
                continue
            low, median, high = quartiles(np.array([found[metric] for _, found in good]))
            first = [found[metric] for seed, found in good if seed == PAPER_SEED]
            printed = PRINTED.get(metric, {}).get(name, {}).get(system) if compared else None
            table.append(
                Cell(
                    orbit=orbit,
                    system=system,
                    noise=noise,
                    acting=acting,
                    method=name,
                    metric=metric,
                    seeds=len(own),
                    failed=len(own) - len(good),
                    median=median,
                    low=low,
                    high=high,
                    paper_seed=float(first[0]) if first else float("nan"),
                    printed=printed,
                )
            )
    return table


def quartiles(values: np.ndarray) -> tuple[float, float, float]:
    """Return lower quartile, median and upper quartile; three NaN without values."""
    if values.size == 0:
        return (float("nan"),) * 3
    low, median, high = np.quantile(values, [0.25, 0.5, 0.75])
    return float(low), float(median), float(high)


def pick(table: Iterable[Cell], **wanted: str) -> list[Cell]:
    """Return the cells whose attributes have the wanted values."""
    return [c for c in table if all(getattr(c, name) == value for name, value in wanted.items())]


def orderings(table: Sequence[Cell]) -> list[str]:
    """Return lines: the paper's methods, ordered where their intervals of quartiles are apart."""
    lines = []
    for system in SYSTEMS:
        own = pick(
            table, orbit="leo", system=system, noise=PAPER, acting=ALL, metric="mean_position_m"
        )
        four = {c.method: c for c in own if c.method in METHODS[:4] and np.isfinite(c.median)}
        apart: list[str] = []
        open_: list[str] = []
        names = sorted(four, key=lambda m: four[m].median)
        for i, first in enumerate(names):
            for second in names[i + 1 :]:
                clear = four[first].high < four[second].low
                (apart if clear else open_).append(f"{first} < {second}")
        printed = sorted(METHODS[:4], key=lambda m: PRINTED["mean_position_m"][m][system])
        lines.append(
            f"{system}: printed {' < '.join(printed)}; ours, apart: {', '.join(apart) or 'none'}; "
            f"intervals overlap: {', '.join(open_) or 'none'}"
        )
    return lines


def verdicts(table: Sequence[Cell], results: Results) -> list[dict[str, Any]]:
    """Return the requirements with value, wanted value, and whether they hold or are forbidden.

    Forbidden: the error expected at the Cramer-Rao bound of all samples exceeds the wanted value.
    """
    found = []
    for metric, best in BEST.items():
        for system, printed in best.items():
            wanted = printed / BETTER_BY
            for cell in pick(
                table, orbit="leo", system=system, noise=PAPER, acting=ALL, metric=metric
            ):
                if not cell.method.startswith("fused"):
                    continue
                bound = pick(
                    table, orbit="leo", system=system, noise=PAPER, acting=ALL,
                    metric=f"bound_{metric}", method="fused",
                )  # fmt: skip
                found.append(
                    {
                        "name": f"{system}, {cell.method}: {metric}, median of {cell.seeds} seeds",
                        "value": cell.median,
                        "wanted": wanted,
                        "passed": bool(cell.median <= wanted),
                        "bound": bound[0].median if bound else None,
                        "forbidden": bool(bound and bound[0].median > wanted),
                    }
                )
    for key, values in results.items():
        if key.startswith(BIAS):
            system = key.split("|")[2]
            for method in ("rda", "fused"):
                removed = values[f"{method}, removed"]
                found.append(
                    {
                        "name": f"{system}, {method}: share of the disturbances' bias removed",
                        "value": removed,
                        "wanted": 0.9,
                        "passed": bool(removed >= 0.9),
                        "forbidden": False,
                    }
                )
    return found


def parameter_tables(results: Results) -> list[dict[str, Any]]:
    """Return Tables 2 and 3: target in LEO by RDA and fused, with and without disturbances."""
    found = []
    for acting, printed in ((ALL, TABLE_2), (NONE, TABLE_3)):
        start = "|".join((SAMPLE, "leo", "target", PAPER, acting, ""))
        for method in ("rda", "fused"):
            reports = [
                values[method]["report"][0]
                for key, values in results.items()
                if key.startswith(start) and "report" in values.get(method, {})
            ]
            if not reports:
                continue
            quarters = np.quantile(np.array(reports), [0.25, 0.5, 0.75], axis=0)
            found.append(
                {
                    "acting": acting,
                    "method": method,
                    "seeds": len(reports),
                    "names": list(PARAMETERS),
                    "printed": list(printed),
                    "low": quarters[0].tolist(),
                    "median": quarters[1].tolist(),
                    "high": quarters[2].tolist(),
                }
            )
    return found


def biases(results: Results) -> dict[str, Mapping[str, Any]]:
    """Return the results of the noise-free study of bias, by system."""
    return {key.split("|")[2]: v for key, v in results.items() if key.startswith(BIAS)}


def plain(table: Sequence[Cell]) -> list[dict[str, Any]]:
    """Return the cells as JSON values."""
    return [asdict(cell) for cell in table]
