"""The content of a report as plain values: sections with texts, tables and charts."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from fsw.messages import FloatArray

MOST_POINTS = 2000  # most points of a line; longer lines are thinned
TIME = "time from the start [s]"


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One line of a chart; `low` and `high` are the edges of its band, None if it has no band."""

    label: str
    y: list[float | None]
    low: list[float | None] | None = None
    high: list[float | None] | None = None
    points: bool = False  # marks without a line between them


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """Lines over one x axis; both labels contain the unit."""

    title: str
    x_label: str
    y_label: str
    x: list[float]
    lines: list[Line]
    log: bool = False
    bars: bool = False
    y_range: tuple[float, float] | None = None  # shown first; None: all
    levels: tuple[str, ...] = ()  # names of 0, 1, 2 ... on the y axis


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table with texts as cells."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """One section of the page; it shows title, text, tables, charts and source in this order."""

    title: str
    text: Sequence[str] = ()
    tables: Sequence[Table] = ()
    charts: Sequence[Chart] = ()
    source: str = ""  # shown folded
    in_rows_of: int = 1  # charts beside one another on a wide page
    folded: str = ""  # name of the fold that hides the charts; empty: they are shown


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """The content of a whole report."""

    title: str
    verdict: str
    valid: bool
    sections: Sequence[Section] = field(default_factory=tuple)

    def charts(self) -> list[dict[str, Any]]:
        """Return the charts of all sections in order, as plain values."""
        return [asdict(chart) for section in self.sections for chart in section.charts]


def times_s(t_ns: Sequence[int], start_ns: int) -> list[float]:
    """Return times [s] from `start_ns`, rounded to microseconds."""
    return [round((t - start_ns) * 1e-9, 6) for t in t_ns]


def line_of(
    label: str, y: FloatArray, low: FloatArray | None = None, high: FloatArray | None = None
) -> Line:
    """Return a thinned line with a band from `low` to `high`; None: no band."""
    band = [None if edge is None else numbers(thinned(edge)) for edge in (low, high)]
    return Line(label=label, y=numbers(thinned(y)), low=band[0], high=band[1])


def thinned(values: FloatArray) -> FloatArray:
    """Return at most `MOST_POINTS` of the values, evenly spaced."""
    return values[:: max(1, -(-len(values) // MOST_POINTS))]


def thinned_axis(values: FloatArray) -> list[float]:
    """Return the x values that belong to thinned lines."""
    return [float(x) for x in thinned(values)]


def numbers(values: FloatArray) -> list[float | None]:
    """Return values for JSON, with seven digits; None replaces a value that is not finite."""
    return [float(f"{x:.7g}") if np.isfinite(x) else None for x in values]
