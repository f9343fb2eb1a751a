"""Work of a study over processes, and the bar that shows how far it is."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from hil.run.processes import end_with_interrupt

U = TypeVar("U")
R = TypeVar("R")


def bar(console: Console) -> Progress:
    """Return the bar of a study; its tasks have a field `text`."""
    return Progress(
        TextColumn("study"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TextColumn("{task.fields[text]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        refresh_per_second=2,
    )


def over(work: Callable[[U], R], units: Sequence[U], jobs: int) -> Iterator[R]:
    """Yield results as they come; each process is new, so its libraries see the pinned threads."""
    if jobs <= 1 or len(units) <= 1:
        yield from map(work, units)
        return
    with multiprocessing.get_context("spawn").Pool(jobs, end_with_interrupt) as pool:
        yield from pool.imap_unordered(work, units)
