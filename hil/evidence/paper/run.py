"""The study's units, run over processes, each result stored as it comes: a rerun goes on."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from hil.errors import same_settings
from hil.evidence.methods.parallel import bar, over
from hil.evidence.paper.cases import ALL, NOISES, NONE, PAPER, PAPER_SEED, PARTS, SYSTEMS, Unit

RESULTS = "results.jsonl"
VERSION = 1
SAMPLE, DEVICE, BIAS = "sample", "device", "bias"


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """How much is run; the paper's seed comes first."""

    rate_hz: float = 500.0
    seeds: int = 20  # per LEO cell of Tables 4-7
    few: int = 5  # per cell of the rest
    device_seeds: int = 20
    systems: tuple[str, ...] = SYSTEMS


def quick_plan() -> Plan:
    """Return one seed of everything at 100 Hz, and no device bytes."""
    return Plan(rate_hz=100.0, seeds=1, few=1, device_seeds=0)


def units(plan: Plan) -> list[Unit]:
    """Return all units: the tables first, seed by seed."""
    found: list[Unit] = []
    for k in range(plan.seeds):
        found += [_unit("leo", system, PAPER, ALL, k) for system in plan.systems]
        found.append(_unit("leo", "target", PAPER, NONE, k))
    for system in plan.systems:
        unit = replace(_unit("leo", system, "ideal", ALL, 0), level=BIAS, methods=())
        found.append(unit)
    for k in range(plan.few):
        for system in plan.systems:
            found.append(_unit("geo", system, PAPER, ALL, k))
            found += [_unit("leo", system, noise, ALL, k) for noise in NOISES if noise != PAPER]
            found += [
                _unit("leo", system, PAPER, acting, k, ("rda", "fused"))
                for acting in PARTS
                if acting != ALL and (acting, system) != (NONE, "target")
            ]
    for k in range(plan.device_seeds):
        for system in plan.systems:
            unit = _unit("leo", system, PAPER, ALL, k, ("fused",))
            found.append(replace(unit, level=DEVICE))
    return found


def _unit(
    orbit: str, system: str, noise: str, acting: str, k: int, methods: tuple[str, ...] | None = None
) -> Unit:
    unit = Unit(
        level=SAMPLE, orbit=orbit, system=system, noise=noise, acting=acting, seed=PAPER_SEED + k
    )
    return unit if methods is None else replace(unit, methods=methods)


def run_unit(unit: Unit, rate_hz: float) -> tuple[str, dict[str, Any]]:
    """Return the unit's key and results by method, plain values."""
    if unit.level == SAMPLE:
        from hil.evidence.paper.identify import run_samples

        return unit.key, run_samples(unit, rate_hz)
    if unit.level == DEVICE:
        from hil.evidence.paper.device import run_device

        return unit.key, run_device(unit)
    from hil.evidence.paper.bias import run_bias

    return unit.key, run_bias(unit)


class Store:
    """Results by key in one folder; a line cut off by a crash is dropped at the next start."""

    def __init__(self, folder: Path, rate_hz: float) -> None:
        same_settings(folder, {"version": VERSION, "rate_hz": rate_hz})
        self._path = folder / RESULTS
        if self._path.exists():
            whole = self._path.read_bytes()
            self._path.write_bytes(whole[: whole.rfind(b"\n") + 1])

    def results(self) -> dict[str, dict[str, Any]]:
        """Return what is stored."""
        if not self._path.exists():
            return {}
        with self._path.open(encoding="utf-8") as lines:
            return dict(map(json.loads, lines))

    def add(self, key: str, values: dict[str, Any]) -> None:
        """Append one unit's results."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps([key, values]) + "\n")


def complete(plan: Plan, store: Store, jobs: int, console: Console) -> dict[str, dict[str, Any]]:
    """Run what the store lacks; return the results of the plan by key."""
    wanted = units(plan)
    done = store.results()
    rest = [unit for unit in wanted if unit.key not in done]
    work = partial(run_unit, rate_hz=plan.rate_hz)
    with bar(console) as progress:
        task = progress.add_task("", total=len(wanted), completed=len(wanted) - len(rest), text="")
        for key, values in over(work, rest, jobs):
            store.add(key, values)
            progress.update(task, advance=1, text=" ".join(key.split("|")[:6]))
    keys = {unit.key for unit in wanted}
    return {key: values for key, values in store.results().items() if key in keys}
