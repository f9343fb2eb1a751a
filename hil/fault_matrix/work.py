"""Rows run in processes of their own, with their outcomes kept in files so that a run resumes."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import lru_cache
from pathlib import Path
from typing import Any

from hil import bench
from hil.fault_matrix import run, table
from hil.fault_matrix.run import Flown


@lru_cache(maxsize=1)
def _setup(seed: int) -> bench.Setup:
    folder = Path(tempfile.mkdtemp(prefix="hil-faults-"))
    return run.prepare(table.load(), seed, folder)


@lru_cache(maxsize=1)
def _clean(seed: int) -> Flown:
    return run.fly(table.load(), _setup(seed), None)


def one(name: str, seed: int) -> dict[str, Any]:
    """Return the outcome of one row."""
    bounds = table.load()
    row = next(row for row in bounds.faults if row.type == name)
    setup = _setup(seed)
    flown = run.fly(bounds, setup, row)
    reference = clean = _clean(seed)
    if row.loses != "nothing":
        reference = run.fly(bounds, setup, row, reference=True)
    return run.outcome(bounds, row, setup, flown, reference, clean)


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
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(todo)), mp_context=context) as pool:
        futures = {pool.submit(one, row.type, seed): row for row in todo}
        for future in as_completed(futures):
            row, values = futures[future], future.result()
            if out is not None:
                out.mkdir(parents=True, exist_ok=True)
                stored = {"key": key(row, seed, commit), "outcome": values}
                (out / f"{row.type}-{seed}.json").write_text(json.dumps(stored))
            yield values
