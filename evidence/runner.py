"""Run long evidence: cases are run by a pool, and their rows are kept in a store.

A campaign is a list of cases and an importable function that turns a case into rows by key. A
campaign that was interrupted continues: cases whose rows are in the store are not run again.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
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

from evidence import pool
from evidence.store import Row, Store

C = TypeVar("C")

Ran = Iterator[tuple[C, Mapping[str, Row]]]


def missing(cases: Sequence[C], key: Callable[[C], str], store: Store) -> list[C]:
    """Return the cases whose key is not in the store."""
    return [case for case in cases if key(case) not in store.rows]


def stored(ran: Ran[C], store: Store) -> Iterator[C]:
    """Add the rows of every case that has run to the store; yield the case."""
    for case, rows in ran:
        for key, row in rows.items():
            store.add(key, row)
        yield case


def bar(title: str, console: Console) -> Progress:
    """Return a progress bar over cases; each of its tasks needs a field `text`."""
    return Progress(
        TextColumn(title),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TextColumn("{task.fields[text]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        refresh_per_second=2,
    )


def rows(
    title: str,
    work: Callable[[C], Mapping[str, Row]],
    cases: Sequence[C],
    store: Store,
    jobs: int,
    text: Callable[[C], str] = str,
) -> list[Row]:
    """Run the cases whose `str(case)` the store lacks as a key; return the rows of all cases."""
    rest, console = missing(cases, str, store), Console(stderr=True)
    complete(title, len(cases), pool.run(work, rest, jobs), rest, store, console, text)
    return [store.rows[str(case)] for case in cases]


def complete(
    title: str,
    total: int,
    ran: Ran[C],
    rest: Sequence[C],
    store: Store,
    console: Console,
    text: Callable[[C], str] = str,
) -> None:
    """Store the rows that `ran` yields and show progress; `rest` of the `total` cases are open."""
    with bar(title, console) as progress:
        task = progress.add_task("", total=total, completed=total - len(rest), text="")
        for case in stored(ran, store):
            progress.update(task, advance=1, text=text(case))
