"""Run the units of the study in processes; each result is stored, so that a rerun continues."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from rich.console import Console

from evidence import pool, runner
from evidence.paper.cases import ALL, NOISES, NONE, PAPER, PAPER_SEED, PARTS, SYSTEMS, PaperUnit
from evidence.store import Row, Store

VERSION = 1
SAMPLE, DEVICE, BIAS = "sample", "device", "bias"


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperPlan:
    """The extent of the study; the first seed is the paper's seed."""

    rate_hz: float = 500.0
    seeds: int = 20  # for each LEO cell of Tables 4-7
    few: int = 5  # seeds for each other cell
    device_seeds: int = 20
    systems: tuple[str, ...] = SYSTEMS


def quick_plan() -> PaperPlan:
    """Return the short study: one seed of everything at 100 Hz, without device level."""
    return PaperPlan(rate_hz=100.0, seeds=1, few=1, device_seeds=0)


def units(plan: PaperPlan) -> list[PaperUnit]:
    """Return all units: first those of the paper's tables, ordered by seed."""
    found: list[PaperUnit] = []
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
) -> PaperUnit:
    unit = PaperUnit(
        level=SAMPLE, orbit=orbit, system=system, noise=noise, acting=acting, seed=PAPER_SEED + k
    )
    return unit if methods is None else replace(unit, methods=methods)


def run_unit(unit: PaperUnit, rate_hz: float) -> dict[str, Row]:
    """Return the unit's results by method, as JSON values, under the unit's key."""
    if unit.level == SAMPLE:
        from evidence.paper.identify import run_samples

        return {unit.key: run_samples(unit, rate_hz)}
    if unit.level == DEVICE:
        from evidence.paper.device import run_device

        return {unit.key: run_device(unit)}
    from evidence.paper.bias import run_bias

    return {unit.key: run_bias(unit)}


def open_store(folder: Path, rate_hz: float) -> Store:
    """Return the store of the study in a folder. Raises ScenarioError if it has other settings."""
    return Store(folder, {"version": VERSION, "rate_hz": rate_hz})


def complete(plan: PaperPlan, store: Store, jobs: int, console: Console) -> dict[str, Row]:
    """Run the units that the store lacks; return all results of the plan by key."""
    wanted = units(plan)
    rest = runner.missing(wanted, _key, store)
    ran = pool.run(partial(run_unit, rate_hz=plan.rate_hz), rest, jobs)
    runner.complete("study", len(wanted), ran, rest, store, console, _text)
    keys = {unit.key for unit in wanted}
    return {key: values for key, values in store.rows.items() if key in keys}


def _key(unit: PaperUnit) -> str:
    return unit.key


def _text(unit: PaperUnit) -> str:
    return " ".join(unit.key.split("|")[:6])
