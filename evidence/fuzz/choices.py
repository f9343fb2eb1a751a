"""An input as decisions: any bytes choose among the alternatives of a grammar."""

from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")


class Choices:
    """Decisions read from bytes one by one; after the last byte, each decision is the first one."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    @property
    def more(self) -> bool:
        """Whether bytes are left."""
        return self._at < len(self._data)

    def number(self, below: int) -> int:
        """Return an integer from 0 to `below` - 1."""
        size = 1 if below <= 1 << 8 else 2 if below <= 1 << 16 else 8
        raw = self._data[self._at : self._at + size]
        self._at += size
        return int.from_bytes(raw, "big") % below

    def one(self, items: Sequence[T]) -> T:
        """Return one of the items."""
        return items[self.number(len(items))]

    def once_in(self, times: int) -> bool:
        """Return True with the probability 1 / `times`; False if no bytes are left."""
        return self.more and self.number(times) == times - 1

    def raw(self, most: int) -> bytes:
        """Return the next bytes of the input, at most `most`."""
        count = self.number(most + 1)
        found = self._data[self._at : self._at + count]
        self._at += count
        return found
