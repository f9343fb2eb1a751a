"""`hil faults --lane disk`: the service on bad disks of every small size."""

import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from evidence import runner
from evidence.disk import case
from evidence.disk.case import Case
from evidence.provenance import commit
from evidence.store import Store
from evidence.terminal import print_table
from hil.world.scenario import ScenarioError

FAILED_EXIT = 1
SHORT_KIB = (1024,)  # of the selection that the tests run
SHORT = (("full", "idle"), ("inodes", "upload"), ("read_only", "restart"), ("removed", "idle"))


def run(*, only: Sequence[str], jobs: int, out: Path | None, as_json: bool, short: bool) -> int:
    """Run the cases and print a table of kinds and moments; return 1 if a case failed, else 0.

    Parameters
    ----------
    only : kinds; empty: all

    Raises
    ------
    ScenarioError if `only` names no kind, or if no disk can be mounted.
    """
    unknown = sorted(set(only) - set(case.KINDS))
    if unknown:
        raise ScenarioError(f"--only: {unknown} not in {list(case.KINDS)}")
    chosen = [item for item in case.cases() if not only or item.kind in only]
    if short:
        chosen = [i for i in chosen if i.size_kib in SHORT_KIB and (i.kind, i.moment) in SHORT]
    store = Store(out, {"lane": "disk", "commit": commit()})
    rows = runner.rows("bad disks", case.run, chosen, store, jobs)
    failed = sum(bool(row["failed"]) for row in rows)
    if as_json:
        sys.stdout.write(json.dumps({"commit": commit(), "cases": rows}) + "\n")
    else:
        _show(chosen, rows, Console())
    return FAILED_EXIT if failed else 0


def _show(cases: Sequence[Case], rows: Sequence[Mapping[str, Any]], console: Console) -> None:
    sizes = sorted({item.size_kib for item in cases})
    moments = [m for m in case.MOMENTS if any(item.moment == m for item in cases)]
    lines = []
    for kind in case.KINDS:
        own = [row for row in rows if row["kind"] == kind]
        if own:
            total = Counter(row["moment"] for row in own)
            good = Counter(row["moment"] for row in own if not row["failed"])
            longest_s, lost = max(r["longest_s"] for r in own), sum(r["lost"] for r in own)
            counts = [f"{good[m]} of {total[m]}" for m in moments]
            lines.append([kind, *counts, f"{longest_s:.1f}", str(lost)])
    print_table(
        f"Bad disks of {sizes[0]} to {sizes[-1]} KiB: cases within every bound",
        ("kind", *moments, "telecommand s", "lost, counted"),
        lines,
        100,
    )
    for row in rows:
        if row["failed"]:
            name = f"{row['size_kib']} KiB, {row['kind']}, {row['moment']}"
            console.print(f"FAILED {name}: {'; '.join(row['failed'])}", soft_wrap=True)
    good_count = sum(not row["failed"] for row in rows)
    console.print(f"{good_count} of {len(rows)} within every bound")
