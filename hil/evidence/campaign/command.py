"""The subcommand `hil campaign`."""

from __future__ import annotations

import json
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from hil.evidence.campaign.config import read
from hil.evidence.campaign.pool import local, on_dask
from hil.evidence.campaign.store import Store
from hil.evidence.campaign.summary import summary

FAILED_EXIT = 1


def campaign(path: Path, out: Path | None, workers: int, scheduler: str | None) -> int:
    """Run or resume a campaign, write its table and summary; 1 if a run failed."""
    wanted = read(path)
    folder = out if out is not None else Path("runs") / path.stem
    store = Store(folder, wanted)
    runs = wanted.runs()
    done = store.rows()
    rest = [run for run in runs if run.key not in done]
    columns = (
        TextColumn("campaign"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), refresh_per_second=2) as progress:
        task = progress.add_task("", total=len(runs), completed=len(runs) - len(rest))
        rows = local(rest, workers) if scheduler is None else on_dask(rest, scheduler)
        for row in rows:
            store.add(row)
            progress.update(task, advance=1)
    found = store.rows()
    ordered = [found[run.key] for run in runs]
    table = store.write_table(ordered)
    entries = summary(ordered)
    text = json.dumps(entries, indent=1)
    (folder / "summary.json").write_text(text, encoding="utf-8")
    console = Console()
    for entry in entries:
        line = f"{entry['scenario']}, {entry['noise']}: {entry['runs']} runs"
        line += f", {entry['failed']} failed, {entry['not_valid']} not valid"
        if "nees" in entry:
            low, high = entry["nees_band"]
            tool = entry["mean_position_m"]
            worst = min(entry["efficiency"])
            line += (
                f"; NEES {entry['nees']:.2f} in [{low:.2f}, {high:.2f}] for {entry['dof']}; "
                f"mean tool error {tool['mean']:.3g} +- {tool['half_interval']:.2g} m; "
                f"least efficiency {worst:.3f}"
            )
        console.print(line, highlight=False, soft_wrap=True)
    console.print(f"table: {table}", soft_wrap=True)
    return FAILED_EXIT if any(entry["failed"] for entry in entries) else 0
