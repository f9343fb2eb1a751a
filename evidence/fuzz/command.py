"""`hil fuzz`: guided fuzzing of every parser, and of the daemon's operations."""

import json
from pathlib import Path

from evidence.fuzz import live as attack
from evidence.fuzz.campaign import Bout
from evidence.fuzz.campaign import keep as keep_corpus
from evidence.fuzz.campaign import run as guided
from evidence.fuzz.many import blocks, summary
from evidence.fuzz.table import TARGETS, quota
from evidence.provenance import seed_or_fresh
from evidence.store import Store
from evidence.terminal import bar
from hil.world.scenario import ScenarioError


def run(
    *,
    inputs: float,
    seed: int | None,
    out: Path,
    keep: Path | None,
    only: str,
    live: bool,
    random: bool,
) -> int:
    """Print failures and the summary; return the exit code, 1 if anything failed.

    Raises
    ------
    ScenarioError if there is no such target, or if its way needs another.
    """
    if only and only not in TARGETS:
        raise ScenarioError(f"--only: {only!r} is none of {', '.join(TARGETS)}")
    for way, chosen in (("--live", live), ("--random", random)):
        if chosen and only != "operations":
            raise ScenarioError(f"{way}: needs --only operations")
    folder, number = out.absolute(), seed_or_fresh(seed, "fuzz")
    if live:
        return _attack(int(inputs), folder, number)
    if random:
        return _many(int(inputs), folder, number)
    shares = quota(int(inputs), only)
    with bar() as progress:
        tasks = {name: progress.add_task(name, total=n) for name, n in shares.items()}

        def tell(bout: Bout) -> None:
            progress.advance(tasks[bout.target], bout.inputs)
            if bout.failure:
                progress.console.print(f"{bout.target}: {bout.failure}", markup=False)

        result = guided(int(inputs), folder, number, tell, only)
    if keep is not None:
        keep_corpus(folder, keep, most=24, most_bytes=2048)
    print(json.dumps(result))
    return int(bool(result["failed"]))


def _attack(cases: int, folder: Path, seed: int) -> int:
    folder.mkdir(parents=True, exist_ok=True)
    with bar() as progress:
        task = progress.add_task("cases", total=cases)
        result = attack.run(cases, folder, seed, lambda done: progress.update(task, completed=done))
    print(json.dumps(result))
    return int(bool(result["faults"] or result["missed"]))


def _many(cases: int, folder: Path, seed: int) -> int:
    store, failed = Store(folder, {"seed": seed, "cases": cases}), False
    with bar() as progress:
        done = sum(row["cases"] for row in store.rows.values())
        task = progress.add_task("cases", total=cases, completed=done)
        for block in blocks(cases, seed, store):
            progress.advance(task, block.cases)
            if block.failure:
                progress.console.print(f"block {block.number}: {block.failure}", markup=False)
                failed = True
    print(json.dumps(summary(store)))
    return int(failed)
