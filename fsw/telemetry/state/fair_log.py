"""Bounded log in which frequent items do not displace rare ones."""

from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

Item = TypeVar("Item")


class FairLog(Generic[Item]):
    """Keeps the newest items of each kind; a full log removes the oldest of the most frequent kind.

    However long a burst of one kind is, every other kind keeps at least an equal share.

    Parameters
    ----------
    capacity : largest number of items
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._kinds: dict[str, deque[tuple[int, Item]]] = {}
        self._added = 0
        self._kept = 0

    def __len__(self) -> int:
        """Return the number of items."""
        return self._kept

    def __iter__(self) -> Iterator[Item]:
        """Yield the items, oldest first."""
        numbered = (pair for kind in self._kinds.values() for pair in kind)
        for _, item in sorted(numbered, key=lambda pair: pair[0]):
            yield item

    def add(self, kind: str, item: Item) -> None:
        """Add an item of a kind; remove one if the log is full."""
        self._kinds.setdefault(kind, deque()).append((self._added, item))
        self._added += 1
        if self._kept < self._capacity:
            self._kept += 1
            return
        fullest = max(self._kinds, key=lambda name: len(self._kinds[name]))
        self._kinds[fullest].popleft()
        if not self._kinds[fullest]:
            del self._kinds[fullest]

    def newest(self, count: int) -> list[Item]:
        """Return at most `count` newest items of all kinds, oldest first."""
        return list(self)[-count:] if count > 0 else []
