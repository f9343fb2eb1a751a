"""Columns of one file, as its reader found them, and what the reader left out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Columns:
    """Columns of one file by name.

    A prefix is a part of names up to a point: `/joint_states`, or `/joint_states.effort`.
    """

    values: Mapping[str, Sequence[str] | NDArray[np.generic]]  # text, or numbers (k,) or (k, m)
    rows: str = "row"  # what a row is called
    lines: Sequence[int] = ()  # number of the line of each row of text
    twice: frozenset[str] = frozenset()  # names that more than one column has
    by_number: Sequence[Sequence[str]] = ()  # columns in order, if numbers may map them
    units: Mapping[str, str] = field(default_factory=dict)  # as a row below the header has them
    absent: Mapping[str, str] = field(default_factory=dict)  # why columns of a prefix are missing
    notes: Mapping[str, Sequence[str]] = field(default_factory=dict)  # by prefix; "": of the file
