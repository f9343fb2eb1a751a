"""Make rows from records: every method, case and sensor set against its bounds; and verdicts."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from scipy import stats
from scipy.linalg import block_diag

from evidence.methods import device_bytes, fisher
from evidence.methods.cases import DEVICE, WIDER, Key, StudyRecord, group_slices, scenario_of
from evidence.methods.flight_side import priors_of
from evidence.methods.methods import CONSISTENT, FUSED, METHODS
from evidence.methods.statistics import CONFIDENCE, Figures, figures
from hil.judge import chi_square
from hil.judge.score import prior_information
from hil.world.inertia import FloatArray

RARE = 1e-3  # probability that the short study fails a correct method
FUSED_BOUND: Mapping[str, float] = {"sample": 1.1, "device": 1.25}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SummaryRow:
    """The figures of one method on one case and sensor set."""

    level: str
    case: str
    sensors: str
    method: str
    figures: Figures
    bias_note: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """One requirement, the value, and whether the requirement holds."""

    name: str
    value: str
    wanted: str
    passed: bool


def rows(records: Mapping[Key, StudyRecord]) -> list[SummaryRow]:
    """Return a row for each level, case, sensor set and method, in the order of the report."""
    found: dict[tuple[str, str, str, str], list[StudyRecord]] = {}
    for key in sorted(records):
        name = (key.level, key.case, key.sensors, key.method)
        found.setdefault(name, []).append(records[key])
    order = list(METHODS)
    table = []
    for (level, case, sensors, method), own in found.items():
        bounds = _bounds(own, fisher.ALL)
        own_bounds = _bounds(own, METHODS[method].own)
        table.append(
            SummaryRow(
                level=level,
                case=case,
                sensors=sensors,
                method=method,
                figures=figures(own, bounds, own_bounds, group_slices(case)),
                bias_note=next((r.bias_note for r in own if r.bias_note), ""),
            )
        )
    return sorted(
        table, key=lambda r: (r.level != "sample", r.case, r.sensors, order.index(r.method))
    )


def verdicts(table: Sequence[SummaryRow], *, quick: bool = False) -> list[Verdict]:
    """Return the verdicts on the requirements on the fused estimator and the consistent methods.

    `quick`: few seeds, so bounds and bands are wide: chance exceeds them once in a thousand times.
    """
    found: list[Verdict] = []
    for row in table:
        if row.method == FUSED:
            found += _fused(row, quick)
    for method in CONSISTENT:
        for level in FUSED_BOUND:
            own = [row for row in table if row.method == method and row.level == level]
            if own:
                found += _nees(method, own, quick)
    return found


def orderings(table: Sequence[SummaryRow]) -> list[str]:
    """Return lines: the methods from best to worst for each case and sensor set, by the median.

    With a good inertial unit MRNEA should be better than RDA, with a poor one worse.
    """
    found: dict[tuple[str, str, str], list[SummaryRow]] = {}
    for row in table:
        found.setdefault((row.level, row.case, row.sensors), []).append(row)
    lines = ["Order by the median seed's error over the bound of all channels:"]
    for (level, case, sensors), own in found.items():
        ranked = sorted(own, key=lambda row: row.figures.median)
        text = " < ".join(f"{row.method} {row.figures.median:.3g}" for row in ranked)
        lines.append(f"  {level}, {case}, {sensors}: {text}")
    return lines + _swaps(table)


def _swaps(table: Sequence[SummaryRow]) -> list[str]:
    """Return lines: the sensor sets for which MRNEA (ols as in the paper, or eiv) is before RDA."""
    median = {(r.level, r.case, r.sensors, r.method): r.figures.median for r in table}
    found: dict[tuple[str, str], dict[bool, list[str]]] = {}
    for (level, case, sensors, method), value in median.items():
        other = median.get((level, case, sensors, "rda"))
        if level != DEVICE and method in ("mrnea ols", "mrnea eiv") and other is not None:
            own = found.setdefault((method, case), {True: [], False: []})
            own[value < other].append(sensors)
    return [
        f"{method} or rda, {case}: {method} first with {', '.join(sets[True]) or 'none'}; "
        f"rda first with {', '.join(sets[False]) or 'none'}"
        for (method, case), sets in sorted(found.items(), reverse=True)
    ]


def provenance(records: Mapping[Key, StudyRecord]) -> list[str]:
    """Return lines: the number of results by level, method and commit."""
    counts: dict[tuple[str, str], dict[str, int]] = {}
    for key, record in records.items():
        own = counts.setdefault((key.level, key.method), {})
        own[record.commit] = own.get(record.commit, 0) + 1
    lines = ["Results by commit of the code that gave them (+: with changes not committed):"]
    for (level, method), own in sorted(counts.items()):
        text = ", ".join(f"{name} {count}" for name, count in sorted(own.items()))
        lines.append(f"  {level}, {method}: {text}")
    return lines


def plain(table: Sequence[SummaryRow], judged: Sequence[Verdict]) -> dict[str, Any]:
    """Return rows and verdicts as values for a JSON file."""
    return {
        "rows": [asdict(row) for row in table],
        "verdicts": [asdict(verdict) for verdict in judged],
        "passed": all(verdict.passed for verdict in judged),
    }


def _fused(row: SummaryRow, quick: bool) -> list[Verdict]:
    f, limit = row.figures, FUSED_BOUND[row.level]
    if quick:
        limit *= (chi_square.mean_ends(f.dof, f.seeds, 2.0 * RARE)[1] / f.dof) ** 0.5
    name = f"{row.level}, {row.case}, {row.sensors}: fused"
    lows = {group: ratio.low for group, ratio in f.groups.items()}
    group = max(lows, key=lambda key: lows[key])
    return [
        Verdict(
            name=f"{name}, whitened error",
            value=f"{f.overall.value:.3f}",
            wanted=f"<= {limit:.3g}",
            passed=f.failed == 0 and f.overall.value <= limit,
        ),
        Verdict(
            name=f"{name}, largest lower end of a group's interval ({group})",
            value=f"{lows[group]:.3f}",
            wanted=f"<= {limit:.3g}",
            passed=lows[group] <= limit,
        ),
    ]


def _nees(method: str, own: Iterable[SummaryRow], quick: bool) -> list[Verdict]:
    """Return the verdict on every row's mean NEES by its 95 % band."""
    found = []
    for row in own:
        f = row.figures
        low, high = f.nees_low, f.nees_high
        if quick:
            low, high = chi_square.mean_ends(f.dof, f.seeds, RARE)
        found.append(
            Verdict(
                name=f"{row.level}, {row.case}, {row.sensors}: {method}, mean NEES",
                value=f"{f.nees:.2f}",
                wanted=f"{low:.2f} .. {high:.2f}",
                passed=f.failed == 0 and low <= f.nees <= high,
            )
        )
    return found


def chance_of_outliers(judged: Sequence[Verdict]) -> tuple[int, int, float]:
    """Return the violated bands, the judged bands, and the chance of so many if all is correct.

    A correct method violates a 95 % band once in twenty times. The chance is only a guide, because
    rows that share seeds count as independent.
    """
    bands = [verdict for verdict in judged if verdict.name.endswith("mean NEES")]
    left = sum(not verdict.passed for verdict in bands)
    chance = float(stats.binom.sf(left - 1, len(bands), 1.0 - CONFIDENCE)) if bands else 1.0
    return left, len(bands), chance


def _bounds(records: Sequence[StudyRecord], channels: str) -> list[FloatArray]:
    """Return the Cramer-Rao bound (p, p) of every record; at device level with the seed's prior."""
    key = records[0].key
    if key.level != DEVICE:
        bound = fisher.bound(fisher.information(key.case, key.sensors, channels))
        return [bound] * len(records)
    data = device_bytes.native_information(key.case, channels)
    found = []
    for record in records:
        priors = priors_of(scenario_of(key.case), record.key.seed, WIDER)
        own = block_diag(*(prior_information(prior) for prior in priors.values()))
        found.append(fisher.bound(data + own))
    return found
