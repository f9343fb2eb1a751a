"""A list of which only a part is in memory: blocks and estimates of a recording of hours."""

import pickle
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from tempfile import TemporaryFile
from typing import IO, Any, TypeVar, overload
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
GROUP = 512  # items that are read together
IN_MEMORY = 4 * GROUP  # first items, which stay in memory: 14 min at 0.4 s


class Shelf(Sequence[T]):
    """Dataclasses in the order in which they were added; those after the first ones are in a file.

    The file has no name, lies in the folder for temporary files, and ends with the process.
    """

    def __init__(self, items: Iterable[T] = ()) -> None:
        self._held: list[T] = []
        self._open: list[T] = []  # the newest group
        self._starts: list[int] = []  # of groups in the file
        self._file: IO[bytes] | None = None
        self._group: tuple[int, list[T]] = (-1, [])  # the last one read
        for item in items:
            self.append(item)

    def append(self, item: T) -> None:
        """Add an item. Raises OSError if the file cannot be written."""
        if len(self._held) < IN_MEMORY:
            self._held.append(item)
            return
        self._open.append(item)
        if len(self._open) == GROUP:
            self._write()

    def __len__(self) -> int:
        """Return the number of items."""
        return len(self._held) + len(self._starts) * GROUP + len(self._open)

    @overload
    def __getitem__(self, place: int) -> T: ...
    @overload
    def __getitem__(self, place: slice) -> list[T]: ...
    def __getitem__(self, place: int | slice) -> T | list[T]:
        """Return an item, or a list of items."""
        if isinstance(place, slice):
            wanted = range(*place.indices(len(self)))
            if wanted.step != 1 or wanted.start < len(self._held):
                return [self[k] for k in wanted]
            found: list[T] = []
            while len(found) < len(wanted):  # the rest of a group at once
                group, at = divmod(wanted.start + len(found) - len(self._held), GROUP)
                found += self._read(group)[at : at + len(wanted) - len(found)]
            return found
        k = place + len(self) if place < 0 else place
        if not 0 <= k < len(self):
            raise IndexError(place)
        if k < len(self._held):
            return self._held[k]
        group, at = divmod(k - len(self._held), GROUP)
        return self._read(group)[at]

    def __iter__(self) -> Iterator[T]:
        """Yield the items, group by group."""
        yield from self._held
        for group in range(len(self._starts)):
            yield from self._read(group)
        yield from self._open

    def _write(self) -> None:
        if self._file is None:
            self._file = TemporaryFile(prefix="fsw-")  # noqa: SIM115
            finalize(self, self._file.close)
        self._starts.append(self._file.seek(0, 2))
        pickle.dump(_columns(self._open), self._file, pickle.HIGHEST_PROTOCOL)
        self._open = []

    def _read(self, group: int) -> list[T]:
        if group == len(self._starts):
            return self._open
        if self._group[0] != group and self._file is not None:
            self._file.seek(self._starts[group])
            kind, columns = pickle.load(self._file)
            rows = zip(*columns.values(), strict=True)
            self._group = group, [kind(**dict(zip(columns, row, strict=True))) for row in rows]
        return self._group[1]


def _columns(items: Sequence[Any]) -> tuple[type, dict[str, Any]]:
    """Return the type of dataclasses, and their values by field: equal arrays are read fast."""
    first = items[0]
    return type(first), {
        own.name: _stacked([getattr(item, own.name) for item in items]) for own in fields(first)
    }


def _stacked(values: list[Any]) -> NDArray[Any] | list[Any]:
    shapes = {own.shape if isinstance(own, np.ndarray) else () for own in values}
    return np.stack(values) if len(shapes) == 1 and shapes != {()} else values
