"""The subcommand `hil campaign`."""

import json
from operator import attrgetter
from pathlib import Path

from rich.console import Console

from evidence import pool, runner
from evidence.campaign.config import read
from evidence.campaign.page import write_page
from evidence.campaign.summary import summary, write_table
from evidence.campaign.work import rows_of, rows_of_lost
from evidence.store import Store

FAILED_EXIT = 1


def campaign(path: Path, out: Path | None, workers: int, scheduler: str | None) -> int:
    """Run or resume a campaign; write its table, summary and page; return 1 if a run failed."""
    wanted = read(path)
    folder = out if out is not None else Path("runs") / path.stem
    store = Store(folder, wanted.model_dump(mode="json"))
    runs = wanted.runs()
    rest = runner.missing(runs, attrgetter("key"), store)
    if scheduler is None:
        ran = pool.over_processes(rows_of, rest, workers, lost=rows_of_lost)
    else:
        keyed = {run.key: run for run in rest}
        ran = pool.over_dask(rows_of, keyed, scheduler, rows_of_lost)
    runner.complete("campaign", len(runs), ran, rest, store, Console(stderr=True))
    ordered = [store.rows[run.key] for run in runs]
    table = write_table(ordered, folder)
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
    paths = write_page(ordered, entries, wanted, folder / "campaign.html")
    console.print(f"page: {', '.join(map(str, paths))}", soft_wrap=True)
    return FAILED_EXIT if any(entry["failed"] for entry in entries) else 0
