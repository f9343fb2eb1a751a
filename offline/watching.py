"""A conditioner that keeps its windows and the blocks made from them.

A window holds all samples, so that a day of them needs gigabytes. Checks of a configuration need
far fewer, with neighbours: of a long recording some stretches are kept, evenly spread.
"""

from collections.abc import Sequence

from fsw.config import Config
from fsw.estimators.conditioning.blocks import Conditioner
from fsw.messages import Block, Window

STRETCH = 256  # successive windows that are kept or not; more than `checks.trial.MOST`
MOST_KEPT = 2048  # 14 min at 0.4 s, some 120 MB


class Watching(Conditioner):
    """The configured conditioner; with `alone` it passes no block on to the estimator.

    It keeps at most `most` windows (None: all): of more windows every second stretch, of twice as
    many every fourth, and so on.
    """

    def __init__(
        self,
        config: Config,
        order: tuple[int, ...],
        *,
        alone: bool = False,
        most: int | None = None,
    ) -> None:
        super().__init__(config, order)
        self.windows: list[Window] = []
        self.made: list[Block] = []
        self._alone, self._most = alone, most
        self._seen, self._every = 0, 1  # number of windows; one stretch of so many is kept

    def blocks(self, windows: Sequence[Window]) -> list[Block | None]:
        """Keep the windows and their blocks; return the blocks, each None if `alone` is set."""
        made = super().blocks(windows)
        for window, block in zip(windows, made, strict=True):
            if self._seen // STRETCH % self._every == 0:
                self.windows.append(window)
                self.made += [] if block is None else [block]
            self._seen += 1
        if self._most is not None and len(self.windows) > self._most:
            self._thin()
        return [None] * len(made) if self._alone else made

    def _thin(self) -> None:
        """Discard every second stretch."""
        self._every *= 2
        self.windows = [w for k, w in enumerate(self.windows) if k // STRETCH % 2 == 0]
        kept = {window.index for window in self.windows}
        self.made = [block for block in self.made if block.index in kept]
