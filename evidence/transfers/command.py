"""`hil transfers`: run the campaign, and print what arrived wrong or late."""

import json
from pathlib import Path

from evidence.provenance import seed_or_fresh
from evidence.store import Store
from evidence.terminal import bar
from evidence.transfers.campaign import campaign, summary


def run(*, count: int, seed: int | None, out: Path) -> int:
    """Print the faults and the summary; return the exit code, 1 if a file is wrong or late."""
    folder, number = out.absolute(), seed_or_fresh(seed, "transfers")
    with bar() as progress:
        task = progress.add_task("transfers", total=count)
        for result in campaign(count, folder, number):
            progress.update(task, completed=result.number + 1)
            if result.fault:
                progress.console.print(f"{result.number}: {result.fault}", markup=False)
    found = summary(Store(folder, {"seed": number}))
    print(json.dumps(found))
    return int(bool(found["faults"] or found["late"]))
