"""Read text tables: delimiters, comments, headers and decimal commas of many tools."""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import takewhile
from math import nan
from pathlib import Path

import numpy as np

from fsw.config.signals import plain_unit
from fsw.errors import ConfigError, brief
from fsw.messages import FloatArray
from offline.importing.columns import Columns
from offline.importing.mapping import FACTORS

DELIMITERS = (
    ";",
    "\t",
    "|",
    ",",
)  # the first that a row of numbers contains; otherwise white space
COMMENTS = ("#", "%", "//")
UNITS = {plain_unit(unit): unit for unit in FACTORS if unit not in ("iso", "1")} | {"sec": "s"}
NOTHING = ("", "nan", "null", "none", "n/a", "na", "-", "#n/a", "1.#qnan", "-1.#ind", "-nan(ind)")
TITLES = 20  # the header is not below so many lines
MOST_DROPPED = 0.01  # share of rows of another length, and at least one row
_DATE = re.compile(r"\d{4}-?\d{2}-?\d{2}([T ]|$)")
_ZONE = re.compile(r"[+-]\d{2}(:?\d{2})?$|[zZ]$")
_SEPARATOR = re.compile(r"sep=.", re.IGNORECASE)  # a first line that Excel reads
_THOUSANDS = re.compile(r"[-+]?\d{1,3}([,' ]\d{3})+(\.\d*)?")
_WITH_UNIT = re.compile(r"[-+]?[\d.,]+\s*[^\W\d]\D*|[-+]?[\d.,]+\s*[°%]")
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d*([eE][-+]?\d+)?")


@dataclass(frozen=True, slots=True)
class _Row:
    number: int
    cells: list[str]


def csv_columns(path: Path) -> Columns:
    """Return the columns of a text table, named by its header, or by their numbers from 1 on.

    Raises
    ------
    ConfigError when the file cannot be read, holds no row, or many rows have another length.
    """
    text = _text(path)
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    is_cut = not text.endswith(("\n", "\r"))
    if is_cut:
        lines.pop()
    is_comment = [
        line.lstrip().startswith(COMMENTS) or _SEPARATOR.fullmatch(line.strip()) is not None
        for _, line in lines
    ]
    body = [line for line, skip in zip(lines, is_comment, strict=True) if not skip]
    if not body:
        raise ConfigError(f"{path}: is empty" + " but for a line that is cut off" * is_cut)
    delimiter = _delimiter(body[len(body) // 2][1])
    rows = [_Row(number, _cells(path, number, line, delimiter)) for number, line in body]
    before = [line for _, line in lines[: is_comment.index(False)]]
    titles = _titles(rows)
    titles += _more_titles(rows[titles:])
    rows = rows[titles:]
    header, is_commented = _header(path, rows, before, delimiter)
    if header is rows[0].cells:
        rows = rows[1:]
    if not rows:
        raise ConfigError(f"{path}: is empty below its header")
    units = rows[0].cells if header and _is_words(rows[0].cells) else []
    rows = rows[bool(units) :]
    if not rows:
        raise ConfigError(f"{path}: is empty below its units")
    names = header or [str(k) for k in range(1, len(rows[0].cells) + 1)]
    whole, notes = _of_one_length(path, rows, len(names))
    comments = sum(is_comment) - is_commented
    notes += [f"comment lines: {comments}"] * bool(comments)
    notes += [f"lines above the header, left out: {titles}"] * bool(titles)
    notes += [f"row of units, left out: {' '.join(units)}"] * bool(units)
    notes += ["last line, which is cut off, left out: 1"] * is_cut
    columns = list(zip(*(row.cells for row in whole), strict=True))
    if any(map(_DECIMAL_COMMA.fullmatch, whole[0].cells)):
        notes.append("decimal commas")
    return Columns(
        values=dict(zip(names, columns, strict=True)),
        lines=[row.number for row in whole],
        twice=frozenset(name for name, count in Counter(names).items() if count > 1),
        by_number=columns,
        units=dict(zip(names, units, strict=False)),
        notes={"": notes},
    )


def numbers(path: Path, name: str, cells: Sequence[str], lines: Sequence[int]) -> FloatArray:
    """Return cells as numbers; a cell without one is NaN.

    Raises
    ------
    ConfigError for a cell that is not a number, or for both decimal commas and decimal points.
    """
    try:
        return np.array(cells, np.float64)
    except ValueError:
        pass
    has_comma = any(_DECIMAL_COMMA.fullmatch(cell) for cell in cells if "," in cell)
    values = np.full(len(cells), nan)
    for row, cell in enumerate(cells):
        try:
            if cell.strip().lower() not in NOTHING:
                values[row] = float(cell.replace(",", ".") if has_comma else cell)
        except ValueError as error:
            hint = "; a date has unit: iso" if _DATE.match(cell) else _addition(cell)
            raise ConfigError(
                f"{path}: line {lines[row]}: {name!r} is {brief(cell)}; must be a number{hint}"
            ) from error
    if has_comma and any("." in cell for cell in cells):
        row = next(row for row, cell in enumerate(cells) if "," in cell)
        raise ConfigError(
            f"{path}: line {lines[row]}: {name!r} is {brief(cells[row])}, and other cells have a "
            "decimal point; must be one of the two"
        )
    return values


def _addition(cell: str) -> str:
    """Return in words what a cell contains besides the digits of a number."""
    if _THOUSANDS.fullmatch(cell):
        return ", without a thousands separator"
    return ", without a unit; the mapping has it" if _WITH_UNIT.fullmatch(cell) else ""


def times_s(path: Path, name: str, cells: Sequence[str], lines: Sequence[int]) -> FloatArray:
    """Return cells of dates and times (ISO 8601) as seconds since 1970; without a zone it is UTC.

    Raises
    ------
    ConfigError for a cell that is not a date and time.
    """
    values = np.full(len(cells), nan)
    for row, cell in enumerate(cells):
        try:
            if cell.strip().lower() in NOTHING:
                continue
            if not _DATE.match(cell.strip()):
                raise ValueError("no date")
            moment = datetime.fromisoformat(cell.strip())
            values[row] = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        except (ValueError, OverflowError) as error:
            raise ConfigError(
                f"{path}: line {lines[row]}: {name!r} is {brief(cell)}; must be date and time, as "
                "ISO 8601 has them"
            ) from error
    return values


def zone_notes(cells: Sequence[str]) -> list[str]:
    """Return a note on times without a zone, with their number if others have one."""
    times = [own for cell in cells if (own := cell.strip()).lower() not in NOTHING]
    bare = sum(_ZONE.search(own[10:]) is None for own in times)
    some = f": {bare} of {len(times)}, the others have one" if bare < len(times) else ""
    return [f"times without a zone, read as UTC{some}"] * bool(bare)


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()
        is_wide = data[:2] in (b"\xff\xfe", b"\xfe\xff")  # as Excel writes Unicode text
        try:
            text = data.decode("utf-16" if is_wide else "utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("cp1252")  # older tools of Windows, whose header has a degree sign
    except (OSError, UnicodeDecodeError) as error:
        words = error.strerror if isinstance(error, OSError) else "it is not text"
        raise ConfigError(f"{path}: cannot be read: {words}") from error
    if not text.strip():
        raise ConfigError(f"{path}: is empty")
    if "\0" in text:
        raise ConfigError(f"{path}: cannot be read: it is not text; a table program saves as CSV")
    return text


def _delimiter(line: str) -> str | None:
    return next((mark for mark in DELIMITERS if mark in line), None)


def _cells(path: Path, number: int, line: str, delimiter: str | None) -> list[str]:
    """Return the cells of one line; each line alone, so that a lost quote costs one row."""
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    try:
        mark = delimiter or " "
        (cells,) = csv.reader([line.strip()], delimiter=mark, skipinitialspace=True)
    except csv.Error as error:
        raise ConfigError(f"{path}: line {number}: {error}") from error
    return [cell.strip() for cell in cells]


def _header(
    path: Path, rows: Sequence[_Row], comments: Sequence[str], delimiter: str | None
) -> tuple[list[str], bool]:
    """Return the header, or nothing, and whether it is a comment."""
    first = rows[0].cells
    if not _is_data(first):
        return first, False
    if comments:
        bare = comments[-1].lstrip().lstrip("#%/").strip()
        cells = _cells(path, rows[0].number - 1, bare, delimiter)
        if len(cells) == len(first) and not _is_data(cells):
            return cells, True
    start = int(first[0]) if first[0].isdecimal() and len(first[0]) < 2 else -1
    is_count = start in (0, 1) and first == [str(k) for k in range(start, start + len(first))]
    return (first if is_count and len(first) > 1 else []), False


def _titles(rows: Sequence[_Row]) -> int:
    """Return how many lines stand above a header that is as wide as most rows, or has more words.

    Without its empty cells at the end a row is narrower: a sensor of a low rate is mostly empty.
    """
    widths = [max((k for k, cell in enumerate(row.cells, 1) if cell), default=0) for row in rows]
    usual, of_all = (
        Counter(of_rows).most_common(1)[0][0]
        for of_rows in (widths, [len(row.cells) for row in rows])
    )
    fits = [
        width == usual or (width > usual and len(row.cells) == of_all)
        for width, row in zip(widths[:TITLES], rows, strict=False)
    ]
    first = fits.index(True) if True in fits else 0
    return 0 if _is_data(rows[first].cells) else first


def _more_titles(rows: Sequence[_Row]) -> int:
    """Return 1 if a title with as many cells stands above the header, which units may follow."""
    words = list(takewhile(lambda row: _is_words(row.cells), rows[:3]))
    units = bool(words) and _is_units(words[-1].cells)
    return int(len(words) == 2 + units and len(set(words[-1 - units].cells)) > 1)


def _is_units(cells: Sequence[str]) -> bool:
    """Return whether a row of words is of units: one stands twice, or one that a mapping knows."""
    held = [plain_unit(cell.strip("[]() ")) for cell in cells if cell]
    return len(set(held)) < len(held) or not UNITS.keys().isdisjoint(held)


def _is_data(cells: Sequence[str]) -> bool:
    """Return whether all cells are numbers, dates, or nothing."""
    return all(map(_is_number, cells)) and any(cells)


def _is_words(cells: Sequence[str]) -> bool:
    """Return whether no cell is a number or a date, as of units, and some are not empty."""
    return any(cells) and not any(cell and _is_number(cell) for cell in cells)


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return cell.lower() in NOTHING or _DATE.match(cell) is not None
    return True


def _of_one_length(
    path: Path, rows: Sequence[_Row], width: int
) -> tuple[Sequence[_Row], list[str]]:
    """Return the rows as long as the header, empty cells at the end removed; notes on others."""
    for row in rows:
        while len(row.cells) > width and not row.cells[-1]:
            row.cells.pop()
    others = [row for row in rows if len(row.cells) != width]
    if not others:
        return rows, []
    first = others[0]
    if len(others) > max(1, MOST_DROPPED * len(rows)) or len(others) == len(rows):
        is_split = len(first.cells) > width and not any("." in cell for cell in first.cells)
        raise ConfigError(
            f"{path}: line {first.number} has {len(first.cells)} values for {width} columns, and "
            f"{len(others)} of {len(rows)} lines have another number than the header"
            + "; decimal commas need another separator, such as semicolons"
            * is_split
        )
    words = f"rows of another length, left out: {len(others)}, the first is line {first.number}"
    return [row for row in rows if len(row.cells) == width], [words]
