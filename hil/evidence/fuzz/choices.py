"""An input as decisions: whatever bytes come, they choose among what a grammar allows."""

from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")


class Choices:
    """Decisions read from bytes, one after the other; without bytes the first of every choice."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    @property
    def more(self) -> bool:
        """Whether bytes are left."""
        return self._at < len(self._data)

    def number(self, below: int) -> int:
        """Return a whole number from 0 on."""
        size = 1 if below <= 1 << 8 else 2 if below <= 1 << 16 else 8
        raw = self._data[self._at : self._at + size]
        self._at += size
        return int.from_bytes(raw, "big") % below

    def one(self, items: Sequence[T]) -> T:
        """Return one of some items."""
        return items[self.number(len(items))]

    def once_in(self, times: int) -> bool:
        """Return True once in so many times; never without bytes."""
        return self.more and self.number(times) == times - 1

    def raw(self, most: int) -> bytes:
        """Return some bytes of the input."""
        count = self.number(most + 1)
        found = self._data[self._at : self._at + count]
        self._at += count
        return found
