"""Rows run in processes of their own, with their outcomes kept in files so that a run resumes."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import lru_cache
from pathlib import Path
from typing import Any

from hil.evidence.fault_matrix import live_rows, machine, real_bus, run, table
from hil.evidence.fault_matrix.run import Flown
from hil.faults.real_bus import cable
from hil.run import bench
from hil.run.processes import end_with_interrupt, tied
from hil.vcan.job import VcanError


@lru_cache(maxsize=1)
def _setup(seed: int) -> bench.Setup:
    folder = Path(tempfile.mkdtemp(prefix="hil-faults-"))
    return run.prepare(table.load(), seed, folder)


@lru_cache(maxsize=1)
def _trunk(seed: int) -> tuple[bench.VirtualRun, Flown]:
    """Return the run the rows branch off, and its clean end."""
    bounds = table.load()
    trunk = run.trunk(bounds, _setup(seed))
    return trunk, run.branch(trunk, bounds, None)


def one(name: str, seed: int) -> dict[str, Any]:
    """Return the outcome of one row."""
    bounds = table.load()
    row = next(row for row in bounds.faults if row.type == name)
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
    """Yield the outcomes of faults of a real bus: here, where there is one, or below `hil vcan`.

    Raises
    ------
    VcanError when that could not be run.
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
    """Return what a stored outcome belongs to."""
    text = json.dumps([row.model_dump(mode="json"), seed, commit], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def outcomes(
    rows: Sequence[table.Row], seed: int, jobs: int, out: Path | None, commit: str
) -> Iterator[dict[str, Any]]:
    """Yield the outcome of every row as it is done; stored ones first."""
    todo = []
    for row in rows:
        path = None if out is None else out / f"{row.type}-{seed}.json"
        if path is not None and path.is_file():
            stored: dict[str, Any] = json.loads(path.read_text())
            if stored["key"] == key(row, seed, commit):
                yield stored["outcome"]
                continue
        todo.append(row)
    if not todo:
        return
    for lane, outcomes_of in REAL.items():
        rows = [row for row in todo if row.lane == lane]
        for row, values in zip(rows, outcomes_of(rows, seed) if rows else (), strict=True):
            _store(out, row, seed, commit, values)
            yield values
    todo = [row for row in todo if row.lane not in REAL]
    if not todo:
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(todo)), context, end_with_interrupt) as pool:
        futures = {pool.submit(one, row.type, seed): row for row in todo}
        for future in as_completed(futures):
            row, values = futures[future], future.result()
            _store(out, row, seed, commit, values)
            yield values


def _store(
    out: Path | None, row: table.Row, seed: int, commit: str, values: dict[str, Any]
) -> None:
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        stored = {"key": key(row, seed, commit), "outcome": values}
        (out / f"{row.type}-{seed}.json").write_text(json.dumps(stored))
