"""Values of mapped columns that no sensor gives: counted by column; single ones are left out."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsw.messages import FloatArray, IntArray
from fsw.messages.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """Columns of one quantity; values (k, width) in SI units."""

    key: str  # of the mapping
    columns: Sequence[str]  # (width,) names
    values: FloatArray  # as the file has them, or once judged: NaN where one cannot be used
    is_read: Sequence[bool] = ()  # (width,) whether a sensor is behind it; empty: all

    @property
    def finite(self) -> FloatArray:
        """The values, NaN where one is infinite."""
        return np.where(np.isfinite(self.values), self.values, np.nan)


def usable(
    path: Path, part: Part, is_far: NDArray[np.bool_], bounds: Sequence[str]
) -> tuple[FloatArray, list[str]]:
    """Return the values with NaN for what cannot be used, and in words what that is, by column.

    Rows in which the quantity is missing altogether are counted as such, not by column.

    Parameters
    ----------
    is_far : (k, width) what is beyond the range that the configuration declares
    bounds : (width,) that range in words

    Raises
    ------
    ConfigError for a column without any usable value.
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
        if said:
            words.append(f"rejected of {column}: {said}")
    return kept, words


def jumps(
    columns: Sequence[str],
    values: FloatArray,
    t_ns: IntArray,
    limits: FloatArray,
    slack: FloatArray,
) -> list[str]:
    """Return a line per column with steps that no joint within its speed limit makes.

    Parameters
    ----------
    columns : (width,) names
    values : (k, width) positions in order of time [rad]
    t_ns : (k,) their stamps [ns]
    limits : (width,) [rad/s]
    slack : (width,) what a step may have beside the joint's motion [rad]
    """
    steps = np.abs(np.diff(values, axis=0))
    allowed = slack + limits * np.diff(t_ns)[:, None] * 1e-9
    return [
        f"jumps of {column} that {limit:g} rad/s do not allow: {count}, the largest "
        f"{step[is_jump].max():.3g} rad"
        for column, limit, step, is_jump in zip(
            columns, limits, steps.T, (steps > allowed).T, strict=True
        )
        if (count := int(is_jump.sum()))
    ]
