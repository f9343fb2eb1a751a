"""Run the missing results of the study in several processes; a result depends only on its key."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from rich.console import Console

from evidence import pool, runner
from evidence.methods import device_bytes, sample_level
from evidence.methods.cases import CASES, DEVICE, SAMPLE, SENSOR_SETS, Key, StudyRecord
from evidence.methods.methods import METHODS
from evidence.methods.records import records, rows
from evidence.store import Row, Store

QUICK_SENSORS = "data sheet"
QUICK_CASE = "target"


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """The extent of the study."""

    sample_seeds: int = 200
    device_seeds: int = 30
    cases: tuple[str, ...] = tuple(CASES)
    sensor_sets: tuple[str, ...] = tuple(SENSOR_SETS)
    device_cases: tuple[str, ...] = tuple(CASES)
    sample_methods: tuple[str, ...] = tuple(METHODS)
    device_methods: tuple[str, ...] = tuple(METHODS)


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyUnit:
    """A unit of work: several methods on the data of one seed."""

    level: str
    case: str
    sensors: str
    seed: int
    methods: tuple[str, ...]

    @property
    def keys(self) -> tuple[Key, ...]:
        """The keys of the unit's results."""
        return tuple(
            Key(
                level=self.level,
                case=self.case,
                sensors=self.sensors,
                method=method,
                seed=self.seed,
            )
            for method in self.methods
        )


def quick_plan() -> Plan:
    """Return the short study: every part of the code runs once or twice, in under a minute."""
    return Plan(
        sample_seeds=2,
        device_seeds=1,
        cases=(QUICK_CASE,),
        sensor_sets=(QUICK_SENSORS,),
        device_cases=(QUICK_CASE,),
        device_methods=("mrnea ols", "mrnea eiv", "rda", "fused"),
    )


def wanted(plan: Plan) -> list[StudyUnit]:
    """Return all units, ordered by seed, so that an interrupted study has equally many of each."""
    units = []
    for seed in range(max(plan.sample_seeds, plan.device_seeds)):
        if seed < plan.device_seeds:
            units += [
                StudyUnit(
                    level=DEVICE,
                    case=case,
                    sensors=device_bytes.SENSORS,
                    seed=seed,
                    methods=plan.device_methods,
                )
                for case in plan.device_cases
            ]
        if seed < plan.sample_seeds:
            units += [
                StudyUnit(
                    level=SAMPLE,
                    case=case,
                    sensors=sensors,
                    seed=seed,
                    methods=plan.sample_methods,
                )
                for case in plan.cases
                for sensors in plan.sensor_sets
            ]
    return units


def missing(units: Sequence[StudyUnit], done: set[Key]) -> list[StudyUnit]:
    """Return the units without methods whose results are done; leave out empty units."""
    rest = []
    for unit in units:
        methods = tuple(key.method for key in unit.keys if key not in done)
        if methods:
            rest.append(replace(unit, methods=methods))
    return rest


def run_unit(unit: StudyUnit) -> dict[str, Row]:
    """Return the rows of the unit's results by their key."""
    if unit.level == DEVICE:
        return rows(device_bytes.run_seed(unit.case, unit.seed, unit.methods))
    return rows(sample_level.run_seed(unit.case, unit.sensors, unit.seed, unit.methods))


def complete(plan: Plan, store: Store, jobs: int, console: Console) -> dict[Key, StudyRecord]:
    """Run the units that the store lacks and show progress; return all records of the plan."""
    units = wanted(plan)
    rest = missing(units, set(records(store)))
    ran = pool.run(run_unit, rest, jobs)
    runner.complete("study", len(units), ran, rest, store, console, _text)
    keys = {key for unit in units for key in unit.keys}
    return {key: record for key, record in records(store).items() if key in keys}


def _text(unit: StudyUnit) -> str:
    return f"{unit.level} {unit.case}, {unit.sensors}, seed {unit.seed}"
