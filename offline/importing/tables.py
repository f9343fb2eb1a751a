"""Read columns of numbers by name from text tables, NumPy .npz or ROS 2 bags."""

import struct
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsw.config.signals import plain_unit
from fsw.errors import ConfigError, brief, cut, unforeseen
from fsw.messages import FloatArray
from offline.importing.bags import bag_columns
from offline.importing.columns import Columns
from offline.importing.csv_file import UNITS, csv_columns, numbers, times_s, zone_notes

TABLES = (".csv", ".txt", ".tsv", ".dat")
# what a damaged archive can raise in NumPy's reader
_BROKEN = (
    OSError,
    ValueError,
    LookupError,
    EOFError,
    TypeError,
    ArithmeticError,
    MemoryError,
    RuntimeError,
    SyntaxError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
SCALED = ("ms", "us", "ns")  # units of numbers, which dates are not
ISO = "iso"  # unit of times that are dates


class Table:
    """The columns of one file: a text table, .npz, or with any other suffix a ROS 2 bag.

    `columns` are the columns of a table that is in memory; `path` is its name in messages then.

    Raises
    ------
    ConfigError when the file cannot be read or is empty, or rosbags is not installed.
    """

    def __init__(self, path: Path, columns: Columns | None = None) -> None:
        self.path = path
        readers = {".npz": _npz_columns} | dict.fromkeys(TABLES, csv_columns)
        if columns is None:
            columns = readers.get(path.suffix.lower(), bag_columns)(path)
        self._columns: Columns = columns
        self._used: set[str] = set()  # names of columns that have been read

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return list(self._columns.values)

    def described(self) -> str:
        """Return the names of the columns, with the reasons why some cannot be used."""
        held = self._columns.values
        shapes: dict[str, tuple[int, ...]]
        shapes = {name: getattr(own, "shape", ()) for name, own in held.items()}
        said = dict.fromkeys(held, "")
        for name, shape in shapes.items():
            if len(shape) == 2:
                turned = " (a row is a sample: transposed?)" if shape[0] < shape[1] else ""
                said[name] = f" {shape[0]} x {shape[1]}{turned}"
        said |= dict.fromkeys(self._columns.twice, " (several columns)")
        said |= {name: f" ({why})" for name, why in self._columns.absent.items()}
        return cut(", ".join(f"{name or repr(name)}{words}" for name, words in said.items()))

    def width(self, name: str) -> int:
        """Return the number of columns of an array, 1 of a column; 0: anything else."""
        held = self._columns.values[name]
        if not isinstance(held, np.ndarray):
            return 1
        if held.dtype.kind not in "fiuM" or held.ndim not in (1, 2):
            return 0
        return 1 if held.ndim == 1 else held.shape[1]

    @property
    def row(self) -> str:
        """What a row is called."""
        return self._columns.rows

    def unit(self, name: str) -> str:
        """Return the unit that a row of units gives a column; empty: none that a mapping knows."""
        return UNITS.get(plain_unit(self._columns.units.get(name, "").strip("[]() ")), "")

    def refuse_other_unit(self, key: str, name: str, unit: str) -> None:
        """Raise ConfigError if a row of units gives a column another known unit than `unit`."""
        if self.unit(name) not in ("", unit):
            raise ConfigError(
                f"{self.path}: {key}: the row of units says {brief(self._columns.units[name])} of "
                f"{name!r}; the mapping says {unit}"
            )

    def has(self, name: str) -> bool:
        """Return whether the file has a column."""
        return name in self._columns.values

    def notes(self, column: str) -> list[str]:
        """Return what the reader left out, of the whole file and of a column's topic."""
        notes = self._columns.notes
        return [*notes.get("", ()), *notes.get(column.partition(".")[0], ())]

    def column(self, name: str, unit: str = "") -> tuple[FloatArray, list[str]]:
        """Return a column (k, m) of k rows, and notes; an empty cell is NaN, dates are seconds.

        Raises
        ------
        ConfigError when no column has this name, or the column contains anything but numbers (or
        dates, with the unit `iso`).
        """
        held = self._held(name)
        notes: list[str] = []
        values: NDArray[np.generic]
        if not isinstance(held, np.ndarray) and unit == ISO:
            values = times_s(self.path, name, held, self._columns.lines)
            notes = zone_notes(held)
        elif not isinstance(held, np.ndarray):
            values = numbers(self.path, name, held, self._columns.lines)
        elif held.dtype.kind == "M" and unit in SCALED:
            raise ConfigError(f"{self.path}: {name!r} holds dates; its unit must be iso")
        elif held.dtype.kind == "M":
            values = np.where(np.isnat(held), np.nan, held.astype("M8[us]").astype(np.int64) * 1e-6)
        else:
            values = held
        if values.dtype.kind not in "fiu" or values.ndim not in (1, 2):
            words = f"holds {values.dtype} of shape {values.shape}"
            raise ConfigError(f"{self.path}: {name!r} {words}; must be numbers, a row a sample")
        return np.atleast_2d(values.astype(np.float64).T).T, notes

    def _held(self, name: str) -> Sequence[str] | NDArray[np.generic]:
        """Return the cells or values of a column that is mapped by name or number."""
        columns = self._columns
        if name in columns.values and name not in columns.twice:
            self._used.add(name)
            return columns.values[name]
        if name in columns.twice:
            words = f"has 2 columns {name!r} or more; map them by their numbers from 1 on"
            raise ConfigError(f"{self.path}: {words}")
        for prefix, reason in columns.absent.items():
            if name == prefix or name.startswith(f"{prefix}."):
                raise ConfigError(f"{self.path}: {name!r}: {reason}")
        if name.isdecimal() and columns.by_number:
            number, last = int(name[:9]), len(columns.by_number)
            if 1 <= number <= last:
                return columns.by_number[number - 1]
            words = f"columns are counted from 1 to {last}"
            raise ConfigError(f"{self.path}: no column {name!r}; {words}")
        free = [own for own in columns.values if own not in self._used]
        close = get_close_matches(name[:100], [x for x in free if _field(x) == _field(name)], n=1)
        hint = f"did you mean {close[0]!r}? " if close else ""
        if all(own.isdecimal() for own in columns.values):
            hint = "its first line has no names; add a line of names, or map columns by number; "
        found = cut(", ".join(columns.values) or "none")
        raise ConfigError(f"{self.path}: no column {name!r}; {hint}it has: {found}")


class Parts:
    """One table, whose rows may come in several files one after another."""

    def __init__(self, tables: Sequence[Table]) -> None:
        self._tables = tables
        self.path, self.row = tables[0].path, tables[0].row

    def has(self, name: str) -> bool:
        """Return whether all parts have a column."""
        return all(table.has(name) for table in self._tables)

    def notes(self, column: str) -> list[str]:
        """Return what the readers left out; of several parts, with the name of the file."""
        if len(self._tables) == 1:
            return self._tables[0].notes(column)
        notes = [(table.path.name, note) for table in self._tables for note in table.notes(column)]
        return [f"{len(self._tables)} files", *(f"{name}: {note}" for name, note in notes)]

    def refuse_other_unit(self, key: str, name: str, unit: str) -> None:
        """Raise ConfigError if a row of units contradicts a unit; see `Table`."""
        for table in self._tables:
            table.refuse_other_unit(key, name, unit)

    def column(self, name: str, unit: str = "") -> tuple[FloatArray, list[str]]:
        """Return a column of all parts, and notes; see `Table.column`."""
        found = [table.column(name, unit) for table in self._tables]
        if len({values.shape[1] for values, _ in found}) > 1:
            raise ConfigError(f"{self.path}: {name!r} has another width in a further file")
        notes = dict.fromkeys(note for _, notes in found for note in notes)
        return np.concatenate([values for values, _ in found]), list(notes)


def _field(name: str) -> str:
    """Return the field of a bag's column, whose topic begins with a slash; otherwise nothing."""
    return name.split(".")[1] if name.startswith("/") and "." in name else ""


def _npz_columns(path: Path) -> Columns:
    values, absent = dict[str, NDArray[np.generic]](), dict[str, str]()
    try:
        with path.open("rb") as file:
            is_archive = zipfile.is_zipfile(file)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    if not is_archive:
        words = "it is not an archive, or cut off; write one with np.savez(path, t=t, q=q)"
        raise ConfigError(f"{path}: cannot be read as .npz: {words}")
    try:
        with np.load(path, allow_pickle=False) as held:
            for name in held.files:
                try:
                    values[name] = np.asarray(held[name])
                except ValueError as error:
                    if "allow_pickle" not in str(error):
                        raise
                    absent[name] = "holds Python objects; save numbers, as np.array(x, float)"
    except _BROKEN as error:
        raise ConfigError(f"{path}: cannot be read as .npz: {unforeseen(error)}") from error
    return Columns(values=values, absent=absent)
