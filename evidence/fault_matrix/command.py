"""`hil faults`: run the fault matrix or a part of it."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import track

from evidence.disk import command as disk
from evidence.fault_matrix import report, table, work
from evidence.provenance import commit
from hil.world.scenario import ScenarioError

FAILED_EXIT = 1
PLAIN_WIDTH = 150


def run(
    *,
    only: Sequence[str],
    lanes: Sequence[str],
    seed: int,
    jobs: int,
    out: Path | None,
    as_json: bool,
    short: bool,
) -> int:
    """Run the chosen rows and print them in the table's order; return 1 if a row failed, else 0.

    Raises
    ------
    ScenarioError if `only` names a fault that is not in the table, or lane disk is not alone.
    """
    if "disk" in lanes:
        if set(lanes) != {"disk"}:
            raise ScenarioError("--lane disk: is a campaign of its own; give no other lane with it")
        return disk.run(only=only, jobs=jobs, out=out, as_json=as_json, short=short)
    bounds = table.load()
    unknown = sorted(set(only) - {row.type for row in bounds.faults})
    if unknown:
        raise ScenarioError(f"--only: {unknown} not in {[row.type for row in bounds.faults]}")
    rows = [
        row
        for row in bounds.faults
        if (not only or row.type in only)
        and (not lanes or row.lane in lanes)
        and (not short or row.short)
    ]
    stamp = commit()
    done = {}
    running = work.outcomes(rows, seed, jobs, out, stamp)
    for values in track(running, "faults", len(rows), console=Console(stderr=True)):
        done[values["type"]] = values
    ordered = [done[row.type] for row in rows]
    if as_json:
        sys.stdout.write(json.dumps({"commit": stamp, "seed": seed, "faults": ordered}) + "\n")
    else:
        console = Console()
        if not console.is_terminal:
            console = Console(width=PLAIN_WIDTH)
        console.print(f"commit {stamp}")
        report.show(ordered, bounds, seed, console)
    return FAILED_EXIT if any(values["failed"] for values in ordered) else 0
