"""Tables of evidence on the terminal."""

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

WRONG = "wrong: seeds with any output that was valid and beyond 5 sigma"


def print_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], width: int, *notes: str
) -> None:
    """Print a table on a terminal of at least `width` characters, and the notes below the table."""
    table = Table(*columns, title=title)
    for row in rows:
        table.add_row(*row)
    console = Console(markup=False)  # units stand in brackets
    console.width = max(console.width, width)
    console.print(table, *notes, sep="\n")


def bar() -> Progress:
    """Return a progress bar on stderr."""
    return Progress(console=Console(stderr=True))
