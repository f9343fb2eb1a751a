"""Some of a sequence's blocks, or all of them changed, without a copy of any."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import overload

import numpy as np

from fsw.messages import Block

Change = Callable[[Block], Block]


def _same(block: Block) -> Block:
    return block


class BlockView(Sequence[Block]):
    """The blocks at some places of a sequence, each changed when it is read."""

    def __init__(
        self, blocks: Sequence[Block], places: Iterable[int], change: Change = _same
    ) -> None:
        self._blocks, self._change = blocks, change
        self._places = np.fromiter(places, np.int64)
        self._is_whole = np.array_equal(self._places, np.arange(len(blocks)))

    def __len__(self) -> int:
        """Return the number of blocks."""
        return len(self._places)

    @overload
    def __getitem__(self, place: int) -> Block: ...
    @overload
    def __getitem__(self, place: slice) -> list[Block]: ...
    def __getitem__(self, place: int | slice) -> Block | list[Block]:
        """Return a block, or a list of blocks."""
        if isinstance(place, slice):
            places = self._places[place].tolist()
            if places and places == list(range(places[0], places[-1] + 1)):  # neighbours
                return [self._change(own) for own in self._blocks[places[0] : places[-1] + 1]]
            return [self._change(self._blocks[k]) for k in places]
        return self._change(self._blocks[int(self._places[place])])

    def __iter__(self) -> Iterator[Block]:
        """Yield the blocks in order."""
        if self._is_whole:
            return map(self._change, self._blocks)
        return (self._change(self._blocks[k]) for k in self._places.tolist())


def changed(blocks: Sequence[Block], change: Change) -> BlockView:
    """Return a view of all blocks that applies `change` to each one when it is read."""
    return BlockView(blocks, range(len(blocks)), change)


def fitting(blocks: Sequence[Block], fits: Iterable[bool]) -> BlockView:
    """Return the blocks for which `fits` holds."""
    return BlockView(blocks, (k for k, fit in enumerate(fits) if fit))
