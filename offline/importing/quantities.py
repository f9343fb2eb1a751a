"""Quantities of a sensor: mapped columns in SI units, and what becomes of their rows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fsw.errors import ConfigError
from fsw.messages import FloatArray, IntArray
from offline.importing.mapping import FACTORS, Quantity, TimeColumn
from offline.importing.tables import Parts
from offline.importing.usable import Part, usable

SAME_S = 1e-6  # stamps of two files that differ by less are one


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Field:
    """Values of one key of a message."""

    values: FloatArray  # (k, width) in SI units; NaN: missing
    unit: str
    words: Callable[[FloatArray], Any]  # returns values (width,) in the form of the message


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """One source's values in SI units."""

    fields: dict[str, Field]  # by key in the message
    needed: FloatArray | None  # rows in which one of these is NaN are left out; None: empty rows
    needs: str  # what a row needs, in words
    rates_hz: dict[str, float]  # declared rates by key of the configuration
    troubles: list[str]  # describe the rejected values
    may_repeat: bool = False  # whether equal readings in a row are samples
    columns: Sequence[str] = field(default=())  # names of the needed columns
    slots: Sequence[str] = field(default=())  # devices or axes of the needed columns
    steps: Callable[[IntArray, IntArray], list[str]] = lambda *_: []  # judges rows and stamps [ns]


class Section(Protocol):
    """The tables of one section of a mapping."""

    def table(self, file: Path | None) -> Parts:
        """Return the table in `file`; None: the table of the section."""
        ...

    @property
    def time(self) -> TimeColumn:
        """The column of the stamps."""
        ...

    @property
    def count(self) -> int | None:
        """Number of stamps; None: static poses, whose stamps follow from the positions."""
        ...

    @property
    def stamps_s(self) -> FloatArray:
        """Stamps (k, 1) of the section's table [s]."""
        ...


def part_of(
    section: Section,
    key: str,
    quantity: Quantity,
    slots: Sequence[str],
    is_read: Sequence[bool] = (),
) -> Part:
    """Return a quantity's columns in SI units, (k, len(slots)); slots: devices or axes.

    Raises
    ------
    ConfigError when the columns do not fit the slots, or their own file lacks or exceeds the
        section's rows.
    """
    if not slots:
        source = key.partition(".")[0]
        raise ConfigError(f"{key}: mapped, and the configuration has no {source}")
    table = section.table(quantity.file)
    names = quantity.columns
    if len(names) == 1 and "{}" in names[0]:
        names = tuple(names[0].replace("{}", slot) for slot in slots)
    columns = [table.column(name)[0] for name in names]
    lengths = {len(column) for column in columns}
    if len(lengths | {section.count} - {None}) > 1:
        words = f"{key}: {', '.join(map(str, sorted(lengths)))} rows"
        words += f", and {section.time.column!r} has {section.count}" * (section.count is not None)
        raise ConfigError(f"{table.path}: {words}; must be as many")
    if quantity.file is not None and section.count is not None and table.has(section.time.column):
        _refuse_other_stamps(section, table)
    values = np.concatenate(columns, axis=1)
    if values.shape[1] != len(slots):
        raise ConfigError(
            f"{table.path}: {key}: {values.shape[1]} columns; must be {len(slots)}, for "
            f"{' '.join(slots)}"
        )
    units = quantity.units * (len(names) if len(quantity.units) == 1 else 1)
    for name, unit in zip(names, units, strict=False):
        if quantity.scale == (1.0,):
            table.refuse_other_unit(key, name, unit)
    if len(names) != len(slots):
        names = tuple(f"{names[0]}[{k}]" for k in range(len(slots)))
    with np.errstate(over="ignore", invalid="ignore"):
        values = values * _factors(key, quantity, len(slots))
    return Part(key=key, columns=names, values=values, is_read=is_read)


def _factors(key: str, quantity: Quantity, width: int) -> FloatArray:
    """Return what turns the values of each column into SI units."""
    factor = np.ones(width)
    units = tuple(FACTORS[unit] for unit in quantity.units)
    given = {"unit": units, "scale": quantity.scale, "sign": quantity.sign}
    for name, values in given.items():
        if len(values) not in (1, width):
            raise ConfigError(f"{key}.{name}: {len(values)} values; must be 1 or {width}")
        factor = factor * np.array(values)
    return factor


def _refuse_other_stamps(section: Section, table: Parts) -> None:
    """Raise ConfigError if a table's stamps are not those of the section's table."""
    time = section.time
    own, _ = table.column(time.column, time.unit)
    own = own * FACTORS[time.unit]
    wrong = ~(np.abs(own - section.stamps_s) <= SAME_S)
    if wrong.any():
        row = int(wrong.any(axis=1).argmax())
        raise ConfigError(
            f"{table.path}: {time.column!r} differs from that of {section.table(None).path} from "
            f"row {row + 1} on: {own[row, 0]:.6f} and {section.stamps_s[row, 0]:.6f} s; files of "
            "one section must have the same rows"
        )


def within(
    section: Section, part: Part, limits: Sequence[float], unit: str
) -> tuple[FloatArray, list[str]]:
    """Return values of at most `limits`, others as NaN, and lines on the rejected ones."""
    bounds = [f"beyond {limit:.4g} {unit}" for limit in limits]
    is_far = np.abs(part.finite) > np.array(limits)
    return usable(section.table(None).path, part, is_far, bounds)


def by_name(names: Sequence[str]) -> Callable[[FloatArray], dict[str, float]]:
    """Return a function that returns the finite values of a row by name."""

    def words(values: FloatArray) -> dict[str, float]:
        finite = np.isfinite(values).tolist()
        rows = zip(names, values.tolist(), finite, strict=True)
        return {name: value for name, value, is_known in rows if is_known}

    return words


def by_sensor(names: Sequence[str]) -> Callable[[FloatArray], dict[str, list[float]]]:
    """Return a function that returns the three values of each sensor by name."""

    def words(values: FloatArray) -> dict[str, list[float]]:
        return dict(zip(names, values.reshape(-1, 3).tolist(), strict=True))

    return words


def listed(values: FloatArray) -> list[float]:
    """Return the values of a row, or nothing if one is missing."""
    known: list[float] = values.tolist() if np.isfinite(values).all() else []
    return known
