"""The subcommands `hil study methods` and `hil study trivial-energy`."""

import json
import os
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from evidence.methods import report, run, summary
from evidence.methods.cases import CASES
from evidence.methods.records import open_store
from evidence.methods.records import records as stored
from evidence.methods.trivial_energy import sentences, trivial_energy
from evidence.store import results_in

FAILED_EXIT = 1


def methods(
    *,
    quick: bool,
    out: Path | None,
    seeds: int | None,
    device_seeds: int | None,
    jobs: int,
    redo: Collection[str] = (),
    report_only: bool = False,
) -> int:
    """Run or resume the study of the methods and print its report; return 1 if a verdict fails.

    `redo` names methods whose stored results are first discarded, after a change of their code.
    `report_only` runs nothing and judges the stored results.
    """
    os.environ["OMP_NUM_THREADS"] = os.environ["NUMBA_NUM_THREADS"] = "1"  # for new processes
    plan = run.quick_plan() if quick else run.Plan()
    if seeds is not None:
        plan = replace(plan, sample_seeds=seeds)
    if device_seeds is not None:
        plan = replace(plan, device_seeds=device_seeds)
    with results_in(out if out or quick else Path("runs") / "study-methods") as folder:
        store = open_store(folder)
        if redo:
            store.forget({k for k, row in store.rows.items() if row["method"] in redo})
        if report_only:
            records = stored(store)
        else:
            records = run.complete(plan, store, jobs, Console(stderr=True))
        rows = summary.rows(records)
        verdicts = summary.verdicts(rows, quick=quick)
        notes = summary.orderings(rows) + summary.provenance(records)
        notes += sentences(trivial_energy("target" if quick else "both"))
        (folder / "report.txt").write_text(report.text(rows, verdicts, notes), encoding="utf-8")
        values = summary.plain(rows, verdicts)
        (folder / "report.json").write_text(json.dumps(values, indent=1), encoding="utf-8")
        console = Console()
        console.width = console.width if console.is_terminal else report.WIDTH
        report.show(rows, verdicts, notes, console)
    return 0 if all(verdict.passed for verdict in verdicts) else FAILED_EXIT


def energy() -> int:
    """Print for every case why CE as printed in the paper fails; return 0."""
    console = Console()
    for case in CASES:
        for line in sentences(trivial_energy(case)):
            console.print(line, highlight=False, markup=False, soft_wrap=True)
    return 0
