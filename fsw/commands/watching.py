"""Conditioning that keeps what it is given and what it makes of it."""

from fsw.config import Config
from fsw.estimators.conditioning import Conditioner
from fsw.messages import Block, Window


class Watching(Conditioner):
    """The configured conditioning; with `alone` nothing is handed on to an estimator."""

    def __init__(self, config: Config, order: tuple[int, ...], *, alone: bool = False) -> None:
        super().__init__(config, order)
        self.windows: list[Window] = []
        self.blocks: list[Block] = []
        self._alone = alone

    def condition(self, window: Window) -> Block | None:
        """Keep the window and its block."""
        self.windows.append(window)
        block = super().condition(window)
        if block is not None:
            self.blocks.append(block)
        return None if self._alone else block
