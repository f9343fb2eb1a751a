"""A conditioner that keeps its windows and the blocks made from them."""

from collections.abc import Sequence

from fsw.config import Config
from fsw.estimators.conditioning import Conditioner
from fsw.messages import Block, Window


class Watching(Conditioner):
    """The configured conditioner; with `alone` it passes no block on to the estimator."""

    def __init__(self, config: Config, order: tuple[int, ...], *, alone: bool = False) -> None:
        super().__init__(config, order)
        self.windows: list[Window] = []
        self.made: list[Block] = []
        self._alone = alone

    def blocks(self, windows: Sequence[Window]) -> list[Block | None]:
        """Keep the windows and their blocks; return the blocks, each None if `alone` is set."""
        self.windows += windows
        made = super().blocks(windows)
        self.made += [block for block in made if block is not None]
        return [None] * len(made) if self._alone else made
