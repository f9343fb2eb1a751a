"""The subcommand `hil study paper`."""

import os
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from evidence.paper import report, run
from evidence.provenance import commit
from evidence.store import results_in

FAILED_EXIT = 1


def paper(*, quick: bool, out: Path | None, seeds: int | None, device_seeds: int | None) -> int:
    """Run or resume the study and write its report; return 1 if a requirement is violated.

    Requirements that the bound forbids do not count. The short study (`quick`) always returns 0.
    """
    os.environ["OMP_NUM_THREADS"] = os.environ["NUMBA_NUM_THREADS"] = "1"  # for new processes
    plan = run.quick_plan() if quick else run.PaperPlan()
    if seeds is not None:
        plan = replace(plan, seeds=seeds, few=min(plan.few, seeds))
    if device_seeds is not None:
        plan = replace(plan, device_seeds=device_seeds)
    with results_in(out if out or quick else Path("runs") / "study-paper") as folder:
        store = run.open_store(folder, plan.rate_hz)
        results = run.complete(plan, store, 2, Console(stderr=True))
        judged = report.write(folder, results, commit())
        console = Console()
        for verdict in judged:
            state = "bound forbids" if verdict["forbidden"] else "missed       "
            state = "holds        " if verdict["passed"] else state
            value, wanted = verdict["value"], verdict["wanted"]
            console.print(
                f"{state} {verdict['name']}: {value:.3g}, wanted {wanted:.3g}",
                highlight=False,
                soft_wrap=True,
            )
        if out is not None or not quick:
            console.print(f"report: {folder / 'report.html'}", soft_wrap=True)
    good = all(verdict["passed"] or verdict["forbidden"] for verdict in judged)
    return 0 if quick or good else FAILED_EXIT
