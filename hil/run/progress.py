"""The live progress bar: current mass with its sigma, and the excitation gathered so far."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn


class Meter(Protocol):
    """Receives the state of a run while it advances."""

    def update(self, done_s: float, summary: Mapping[str, Any] | None) -> None:
        """Show the time done [s] and the newest estimate's summary."""
        ...


class Quiet:
    """A meter that shows nothing."""

    def update(self, done_s: float, summary: Mapping[str, Any] | None) -> None:
        """Show nothing."""


class RichMeter:
    """A bar on a console."""

    def __init__(self, progress: Progress, total_s: float) -> None:
        self._progress = progress
        self._task = progress.add_task("", total=total_s, text="waiting for the first estimate")

    def update(self, done_s: float, summary: Mapping[str, Any] | None) -> None:
        """Move the bar; keep the last text while there is nothing newer."""
        if summary is None:
            self._progress.update(self._task, completed=done_s)
        else:
            self._progress.update(self._task, completed=done_s, text=describe(summary))


def describe(summary: Mapping[str, Any]) -> str:
    """Return one line of an estimate's summary: masses, information gained, validity."""
    masses = [
        f"{body} {values['mass_kg']:.1f} ± {summary['sigma'][body]['mass_kg']:.2g} kg"
        for body, values in summary["estimate"].items()
    ]
    gained = summary.get("information_gained_nats")
    excitation = f"{gained:.0f} nats" if gained is not None else "no information"
    state = "valid" if summary["valid"] else str(summary["reason"]).lower().replace("_", " ")
    return f"{', '.join(masses)} · {excitation} · {state}"


@contextmanager
def meter(title: str, total_s: float, console: Console) -> Iterator[Meter]:
    """Show a bar on the console during the run."""
    columns = (
        TextColumn(title),
        BarColumn(bar_width=20),
        TextColumn("{task.completed:.0f}/{task.total:.0f} s"),
        TextColumn("{task.fields[text]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, refresh_per_second=5) as progress:
        yield RichMeter(progress, total_s)
