"""`hil bench`: the whole daemon in real time, alone and loaded."""

import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console

from evidence.speed import whole
from evidence.store import Store
from hil.run.progress import meter


def run(
    *,
    scenario: str,
    rounds: int,
    seconds: float,
    only: Sequence[str],
    bus: str,
    out: Path | None,
    as_json: bool,
) -> int:
    """Measure the conditions that the folder lacks, print the summary, and return 0."""
    store = Store(out, {"bench": scenario, "seconds": seconds, "bus": bus})
    names, found = only or whole.CONDITIONS, []
    for k in range(rounds):
        for name in names:
            key, title = f"{name} {k}", f"round {k + 1} of {rounds}, {name}"
            if key not in store.rows:
                console = Console(stderr=True)
                with meter(title, seconds + whole.SETTLE_S, console) as shown:
                    measured = whole.measure(scenario, name, seconds, shown, bus)
                sys.stderr.write(measured.to_text() + "\n")
                store.add(key, asdict(measured))
        found.append([whole.Condition(**store.rows[f"{name} {k}"]) for name in names])
    print(whole.as_json(found) if as_json else whole.summary(found))
    return 0
