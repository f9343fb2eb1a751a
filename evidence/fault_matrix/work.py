"""Run rows in separate processes; keep their outcomes in a store, so that a run can be resumed."""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from evidence import pool, runner
from evidence.fault_matrix import live_rows, machine, real_bus, run, table
from evidence.fault_matrix.run import FlownRow
from evidence.store import Store
from hil.faults.real_bus import cable
from hil.run import bench
from hil.run.processes import tied
from hil.vcan.job import VcanError


@lru_cache(maxsize=1)
def _setup(seed: int) -> bench.Setup:
    folder = Path(tempfile.mkdtemp(prefix="hil-faults-"))
    return run.prepare(table.load(), seed, folder)


@lru_cache(maxsize=1)
def _trunk(seed: int) -> tuple[bench.VirtualRun, FlownRow]:
    """Return the run from which the rows start, and its clean continuation."""
    bounds = table.load()
    trunk = run.trunk(bounds, _setup(seed))
    return trunk, run.branch(trunk, bounds, None)


def one(row: table.Row, seed: int) -> dict[str, Any]:
    """Return the outcome of one row in virtual time."""
    bounds = table.load()
    trunk, clean = _trunk(seed)
    flown = run.branch(trunk, bounds, row)
    reference = clean
    if row.loses != "nothing":
        reference = run.branch(trunk, bounds, row, reference=True)
    return run.outcome(bounds, row, _setup(seed), flown, reference, clean)


def machine_outcomes(rows: Sequence[table.Row], seed: int) -> Iterator[dict[str, Any]]:
    """Yield the outcomes of faults of the machine, in real time."""
    return live_rows.outcomes(machine.lane(), table.load(), rows, seed)


def bus_outcomes(rows: Sequence[table.Row], seed: int) -> Iterator[dict[str, Any]]:
    """Yield the outcomes of faults of a real bus; outside `hil vcan`, run that command.

    Raises
    ------
    VcanError if `hil vcan` gives no outcomes.
    """
    if os.environ.get("HIL_VCAN"):
        with cable(real_bus.NEAR, real_bus.FAR):
            yield from live_rows.outcomes(real_bus.lane(), table.load(), rows, seed)
        return
    command = [sys.executable, "-m", "hil", "vcan", "--realtime", "--", sys.executable, "-m", "hil"]
    command += ["faults", "--lane", "socketcan", "--seed", str(seed), "--json"]
    command += [word for row in rows for word in ("--only", row.type)]
    done = subprocess.run(tied(command), stdout=subprocess.PIPE, text=True, check=False)
    if not done.stdout:
        raise VcanError(f"hil vcan: exit {done.returncode}")
    yield from json.loads(done.stdout)["faults"]


REAL: Mapping[str, Callable[[Sequence[table.Row], int], Iterator[dict[str, Any]]]] = {
    "machine": machine_outcomes,
    "socketcan": bus_outcomes,
}


def key(row: table.Row, seed: int, commit: str) -> str:
    """Return the key of a row's outcome in the store."""
    text = json.dumps([row.model_dump(mode="json"), seed, commit], sort_keys=True)
    return f"{row.type}-{seed}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"


def outcomes(
    rows: Sequence[table.Row], seed: int, jobs: int, out: Path | None, commit: str
) -> Iterator[dict[str, Any]]:
    """Yield the stored outcomes, then the outcome of every other row as soon as it is done."""
    store = Store(out, {})
    name = partial(key, seed=seed, commit=commit)
    todo = runner.missing(rows, name, store)
    for row in rows:
        if row not in todo:
            yield dict(store.rows[name(row)])
    for row, values in _run(todo, seed, jobs):
        store.add(name(row), values)
        yield values


def _run(
    rows: Sequence[table.Row], seed: int, jobs: int
) -> Iterator[tuple[table.Row, dict[str, Any]]]:
    """Yield rows with their outcomes: first in real time, one by one, then in virtual time."""
    for lane, outcomes_of in REAL.items():
        own = [row for row in rows if row.lane == lane]
        yield from zip(own, outcomes_of(own, seed) if own else (), strict=True)
    virtual = [row for row in rows if row.lane not in REAL]
    yield from pool.over_processes(partial(one, seed=seed), virtual, min(jobs, len(virtual)))
