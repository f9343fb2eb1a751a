"""Conditioning that keeps what it is given and what it makes of it."""

from collections.abc import Sequence

from fsw.config import Config
from fsw.estimators.conditioning import Conditioner
from fsw.messages import Block, Window


class Watching(Conditioner):
    """The configured conditioning; with `alone` nothing is handed on to an estimator."""

    def __init__(self, config: Config, order: tuple[int, ...], *, alone: bool = False) -> None:
        super().__init__(config, order)
        self.windows: list[Window] = []
        self.made: list[Block] = []
        self._alone = alone

    def blocks(self, windows: Sequence[Window]) -> list[Block | None]:
        """Keep the windows and their blocks."""
        self.windows += windows
        made = super().blocks(windows)
        self.made += [block for block in made if block is not None]
        return [None] * len(made) if self._alone else made
