"""Closed windows, worked off in bounded units, a backlog at once."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable

from fsw.messages import Window
from fsw.scheduler.tasks import TaskTimes

ENDED = object()


class WindowWork:
    """The closed windows that wait, and the one being worked off.

    Parameters
    ----------
    use : works one window off, in bounded units
    """

    def __init__(self, use: Callable[[Window], Generator[None, None, None]]) -> None:
        self._use = use
        self._closed: deque[Window] = deque()
        self._job: Generator[None, None, None] | None = None
        self._fresh = False
        self.delays = TaskTimes()  # from a window's closing to its published estimate

    @property
    def is_busy(self) -> bool:
        """Whether a closed window waits or is half worked off."""
        return self._job is not None or bool(self._closed)

    @property
    def is_behind(self) -> bool:
        """Whether more than one window has not been worked off."""
        return len(self._closed) > (self._job is None)

    def add(self, windows: Iterable[Window]) -> None:
        """Accept the windows that closed in this tick."""
        self._closed += windows
        self._fresh = True

    def take_fresh(self) -> bool:
        """Return whether a window has closed since the last call."""
        fresh, self._fresh = self._fresh, False
        return fresh

    def advance(self) -> None:
        """Do one unit of the current window; without one, begin the next."""
        if self._job is None and self._closed:
            self._job = self._use(self._closed.popleft())
        if self._job is not None and next(self._job, ENDED) is ENDED:
            self._job = None

    def drop(self) -> None:
        """Give the window at hand up."""
        self._job = None
