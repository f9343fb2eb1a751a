"""Values of mapped columns that cannot be used: counted by column, and left out."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsw.messages import FloatArray
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
