"""Count values of mapped columns that no sensor gives; single values are replaced by NaN."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsw.errors import ConfigError
from fsw.messages import FloatArray, IntArray

MANY = 0.05  # share of values out of range, or of steps too fast, that single errors do not explain
UNIT = "is the unit in the mapping right (rad or deg, m or mm, N m or mN m, m/s2 or g)?"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """Columns of one quantity; values (k, width) in SI units."""

    key: str  # key of the mapping
    columns: Sequence[str]  # (width,) names
    values: FloatArray  # of the file, sign and scale applied; NaN: empty cell
    is_read: Sequence[bool] = ()  # (width,) whether the column belongs to a sensor; empty: all do

    @property
    def finite(self) -> FloatArray:
        """The values, with NaN instead of infinite ones."""
        return np.where(np.isfinite(self.values), self.values, np.nan)


def usable(
    path: Path, part: Part, is_far: NDArray[np.bool_], bounds: Sequence[str]
) -> tuple[FloatArray, list[str]]:
    """Return the values with NaN for unusable ones, and a text for each column with such values.

    Rows in which all columns are NaN get one common text.

    Parameters
    ----------
    is_far : (k, width) whether a value is outside the range that the configuration declares
    bounds : (width,) words for a value outside the range

    Raises
    ------
    ConfigError for a column of a sensor without any usable value.
    """
    values, missing = part.values, np.isnan(part.values)
    is_blank = missing.all(axis=1)
    kept = np.where(is_far, np.nan, part.finite)
    words = [f"{part.key} missing in {count} rows"] if (count := int(is_blank.sum())) else []
    for k, (column, bound) in enumerate(zip(part.columns, bounds, strict=True)):
        if part.is_read and not part.is_read[k]:
            continue
        counts = {
            "not a number": int((missing[:, k] & ~is_blank).sum()),
            "infinite": int(np.isinf(values[:, k]).sum()),
            bound: int(is_far[:, k].sum()),
        }
        said = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
        if np.isnan(kept[:, k]).all():
            said = said or f"{len(values)} not a number"
            raise ConfigError(f"{path}: {part.key}: {column!r} has no usable value: {said}")
        if is_far[:, k].sum() > MANY * len(values):
            said = f"{said}; {UNIT}"
        if said:
            words.append(f"rejected of {column}: {said}")
    return kept, words


def jumps(
    columns: Sequence[str],
    values: FloatArray,
    t_ns: IntArray,
    limits: FloatArray,
    slack: FloatArray,
    units: Sequence[str],
) -> list[str]:
    """Return a line per column with steps that exceed the speed limit of the joint.

    Parameters
    ----------
    columns : (width,) names
    values : (k, width) positions in order of time [rad, or m]
    t_ns : (k,) their stamps [ns]
    limits : (width,) speed limits [rad/s, or m/s]
    slack : (width,) allowance added to the motion at that limit [rad, or m]
    units : (width,) unit of each position
    """
    steps = np.abs(np.diff(values, axis=0))
    allowed = slack + limits * np.diff(t_ns)[:, None] * 1e-9
    return [
        f"jumps of {column} that {limit:g} {unit}/s do not allow: {count}, the largest "
        f"{step[is_jump].max():.3g} {unit}" + f"; {UNIT}" * (count > MANY * len(step))
        for column, limit, unit, step, is_jump in zip(
            columns, limits, units, steps.T, (steps > allowed).T, strict=True
        )
        if (count := int(is_jump.sum()))
    ]
