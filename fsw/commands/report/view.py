"""The parts of a report as plain values: sections of texts, tables and charts."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from fsw.messages import FloatArray

MOST_POINTS = 2000  # of a line; more are thinned
TIME = "time from the start [s]"


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One line of a chart; `low` and `high` bound its band."""

    label: str
    y: list[float | None]
    low: list[float | None] | None = None
    high: list[float | None] | None = None
    points: bool = False  # marks without a line between them


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """Lines over one axis; both axes carry their units."""

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
    """A table of texts."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """One heading of the page, in the order text, tables, charts, source."""

    title: str
    text: Sequence[str] = ()
    tables: Sequence[Table] = ()
    charts: Sequence[Chart] = ()
    source: str = ""  # shown folded
    in_rows_of: int = 1  # charts beside one another on a wide page


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A whole report."""

    title: str
    verdict: str
    valid: bool
    sections: Sequence[Section] = field(default_factory=tuple)

    def charts(self) -> list[dict[str, Any]]:
        """Return every chart in order, as plain values."""
        return [asdict(chart) for section in self.sections for chart in section.charts]


def times_s(t_ns: Sequence[int], start_ns: int) -> list[float]:
    """Return times from a start [s]."""
    return [round((t - start_ns) * 1e-9, 6) for t in t_ns]


def line_of(
    label: str, y: FloatArray, low: FloatArray | None = None, high: FloatArray | None = None
) -> Line:
    """Return a line, thinned, with the edges of its band."""
    band = [None if edge is None else numbers(thinned(edge)) for edge in (low, high)]
    return Line(label=label, y=numbers(thinned(y)), low=band[0], high=band[1])


def thinned(values: FloatArray) -> FloatArray:
    """Return at most `MOST_POINTS` values, evenly taken."""
    return values[:: max(1, -(-len(values) // MOST_POINTS))]


def thinned_axis(values: FloatArray) -> list[float]:
    """Return the x values that belong to thinned lines."""
    return [float(x) for x in thinned(values)]


def numbers(values: FloatArray) -> list[float | None]:
    """Return values for JSON: seven digits, None where not finite."""
    return [float(f"{x:.7g}") if np.isfinite(x) else None for x in values]
