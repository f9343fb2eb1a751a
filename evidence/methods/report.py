"""The study's report: tables of rows and verdicts for the console and a file."""

from collections.abc import Sequence
from io import StringIO

from rich.console import Console
from rich.table import Table

from evidence.methods.statistics import EfficiencyRatio, Figures
from evidence.methods.summary import SummaryRow, Verdict, chance_of_outliers

WIDTH = 260
LEVELS = {
    "sample": "Sample level: 60 s at 100 Hz, white noise on raw samples, hardly a prior",
    "device": "Device bytes: plant, wire, daemon; raw sensors' white noise at native rates",
}
LEGEND = """\
Ratios are root-mean-square errors over the Cramer-Rao bound of all channels, whitened within the \
group and divided by its dimension, with the 95 % interval below (bootstrap over seeds; under ten \
of them chi-square); 1 is the least possible.
own: all parameters, against the bound of the method's own channels. median, worst: of one \
seed's root-mean-square whitened error. NEES: mean over seeds (median), and the 95 % band of that \
mean for a right covariance (chi-square). biased: groups whose mean error is not zero (Hotelling, \
0.1 %), its largest component in sigmas of the bound. not OK: seeds on which the method itself \
says so."""


def tables(rows: Sequence[SummaryRow]) -> list[Table]:
    """Return one table for each level and case."""
    found = []
    for level, title in LEVELS.items():
        for case in dict.fromkeys(row.case for row in rows if row.level == level):
            own = [row for row in rows if (row.level, row.case) == (level, case)]
            found.append(_table(f"{title}; unknown: {case}", own))
    return found


def verdict_table(verdicts: Sequence[Verdict]) -> Table:
    """Return the table of the requirements with their verdicts."""
    table = Table(title="Required")
    for title in ("what", "value", "wanted", ""):
        table.add_column(title, justify="left" if title == "what" else "right")
    for verdict in verdicts:
        mark = "pass" if verdict.passed else "FAIL"
        table.add_row(verdict.name, verdict.value, verdict.wanted, mark)
    return table


def show(
    rows: Sequence[SummaryRow], verdicts: Sequence[Verdict], notes: Sequence[str], console: Console
) -> None:
    """Print tables, legend, notes and verdicts."""
    for table in tables(rows):
        console.print(table)
    console.print(LEGEND, highlight=False, markup=False)
    for note in notes:
        console.print(note, highlight=False, markup=False)
    console.print(verdict_table(verdicts))
    left, bands, chance = chance_of_outliers(verdicts)
    if bands:
        console.print(
            f"{left} of {bands} NEES bands left; if every covariance is right, that many or more "
            f"happen with probability {chance:.2g}",
            highlight=False,
        )


def text(rows: Sequence[SummaryRow], verdicts: Sequence[Verdict], notes: Sequence[str]) -> str:
    """Return the report as plain text."""
    console = Console(file=StringIO(), width=WIDTH, color_system=None)
    show(rows, verdicts, notes, console)
    written = console.file
    return written.getvalue() if isinstance(written, StringIO) else ""


def _table(title: str, rows: Sequence[SummaryRow]) -> Table:
    table = Table(title=title)
    groups = list(rows[0].figures.groups)
    left = ("sensors", "method", "biased")
    titles = ["sensors", "method", "all", *groups, "own", "median", "worst", "NEES", "band"]
    for name in [*titles, "not OK", "biased"]:
        table.add_column(name, justify="left" if name in left else "right")
    sensors = ""
    for row in rows:
        f = row.figures
        table.add_row(
            row.sensors if row.sensors != sensors else "",
            row.method,
            _ratio(f.overall),
            *(_ratio(f.groups[group]) for group in groups),
            number(f.own_overall.value),
            number(f.median),
            f"{number(f.worst)} (seed {f.worst_seed})",
            f"{number(f.nees)} ({number(f.nees_median)})",
            f"{f.nees_low:.1f}..{f.nees_high:.1f}",
            f"{f.not_ok}/{f.seeds}",
            _bias(f),
        )
        sensors = row.sensors
    return table


def number(value: float) -> str:
    """Return the text of a value with three digits, or two in exponential form from 1e4 on."""
    return f"{value:.3g}" if abs(value) < 1e4 else f"{value:.1e}"


def _ratio(ratio: EfficiencyRatio) -> str:
    return f"{number(ratio.value)}\n[dim]{number(ratio.low)}..{number(ratio.high)}[/dim]"


def _bias(f: Figures) -> str:
    return "\n".join(f"{group} {number(value)}" for group, value in f.biased.items())
