"""`hil kills`: run the campaign, and print what was lost or late."""

import json
from pathlib import Path

from evidence.kills.campaign import campaign, summary
from evidence.provenance import seed_or_fresh
from evidence.terminal import bar
from hil.run.live import LiveError


def run(*, count: int, seed: int | None, out: Path) -> int:
    """Print the faults and the summary; return the exit code, 1 if anything was lost or late."""
    folder, failed = out.absolute(), False
    number = seed_or_fresh(seed, "kills")
    with bar() as progress:
        task = progress.add_task("kills", total=count)
        try:
            for kill in campaign(count, folder, number):
                progress.advance(task)
                for fault in (*kill.faults, *kill.late):
                    text = f"round {kill.round} kill {kill.number} ({kill.victim}): {fault}"
                    progress.console.print(text, markup=False)
        except LiveError as error:
            progress.console.print(str(error), markup=False)
            failed = True
    result = summary(folder, number)
    print(json.dumps(result))
    return int(bool(failed or result["faults"] or result["late"]))
