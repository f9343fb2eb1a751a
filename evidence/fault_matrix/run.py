"""One row of the matrix in virtual time: the run with the fault, its reference, the verdict."""

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from evidence import pool
from evidence.fault_matrix.table import Row, Table
from fsw.messages import Event
from fsw.messages.findings import Fault
from hil.faults.place import Place
from hil.faults.script import install
from hil.judge.score import Result, normalised_error_squared
from hil.run import bench
from hil.run.progress import Quiet
from hil.world.inertia import FloatArray, pi_of
from hil.world.scenario import Scenario
from hil.world.scenario import load as load_scenario

SCENARIO = "target_leo"
MARGIN_S = 0.1  # time from the end of the trunk to the first fault


def prepare(
    table: Table,
    seed: int,
    folder: Path,
    *,
    real_time: bool = False,
    scenario: Scenario | None = None,
) -> bench.Setup:
    """Return the set-up of the short motion that every row uses."""
    scenario = dataclasses.replace(scenario or load_scenario(SCENARIO), before_s=table.before_s)
    setup = bench.prepare(scenario, seed, folder, real_time=real_time)
    after_s = scenario.after_s - (setup.total_s - table.total_s)
    return dataclasses.replace(setup, scenario=dataclasses.replace(scenario, after_s=after_s))


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlownRow:
    """Results of a run, with the times when its fault began and its device recovered (0: clean)."""

    final: Result
    events: Sequence[Event]
    status: Mapping[str, Any]
    restored: bool  # whether the last window had every channel
    began_ns: int
    returned_ns: int
    wall_s: float

    @property
    def sigma(self) -> FloatArray:
        """1 sigma (p,) of the parameters of the unknown bodies."""
        return np.asarray(np.sqrt(np.diag(self.final.covariance)))


def trunk(table: Table, setup: bench.Setup) -> bench.VirtualRun:
    """Return the clean run, advanced to shortly before the first fault; every row starts there."""
    run = bench.VirtualRun(setup, record=False)
    first_s = min(table.times(row)[0] for row in table.faults if row.lane == "virtual")
    run.advance(first_s - MARGIN_S, Quiet())
    return run


def branch(
    trunk: bench.VirtualRun, table: Table, row: Row | None, *, reference: bool = False
) -> FlownRow:
    """Continue a copy of the trunk: with a fault, as its reference, or clean (`row` None).

    The copy is a forked process, so the trunk itself does not advance.

    Raises
    ------
    RuntimeError if the copy ends without a result.
    """
    name = "the clean run" if row is None else row.type
    return pool.forked(name, lambda: _carry_on(trunk, table, row, reference=reference))


def _carry_on(run: bench.VirtualRun, table: Table, row: Row | None, *, reference: bool) -> FlownRow:
    places: list[Place] = []
    if row is not None:
        entries = [table.entry(row)]
        seed = run.setup.seed
        places = install(entries, run.world, seed, bench.T0_NS, reference=reference)
    run.advance(run.setup.total_s, Quiet())
    recorded = run.finish(Quiet())
    last = recorded.blocks[-1]
    return FlownRow(
        final=recorded.final,
        events=recorded.events,
        status=recorded.status,
        restored=bool(
            last.index == recorded.status["windows"]["closed"] - 1
            and last.has_joint.all()
            and last.has_gyro
            and last.has_accelerometer
        ),
        began_ns=places[0].began_ns if places else 0,
        returned_ns=places[0].returned_ns if places else 0,
        wall_s=recorded.wall_s,
    )


def outcome(
    table: Table,
    row: Row,
    setup: bench.Setup,
    flown: FlownRow,
    reference: FlownRow,
    clean: FlownRow,
) -> dict[str, Any]:
    """Return the figures of a row, and under `failed` the names of the violated bounds.

    Events that the clean run of the same seed also reports are not counted as other events.
    """
    final = flown.final
    truth = np.concatenate([pi_of(setup.scenario.truth[b]) for b in setup.scenario.unknown])
    usual = {e.code for e in clean.events}
    health = flown.status["health"]
    values = told(table, row, flown.events, (flown.began_ns, flown.returned_ns), usual) | {
        "nees": normalised_error_squared(final.x - truth, final.covariance),
        "nees_bound": float(chi2.ppf(table.probability, len(truth))),
        "sigma_ratio": float(np.max(flown.sigma / reference.sigma)),
        "counters": {name: int(n) for name, n in health["incidents"].items()},
        "counted": int(health["incidents"].get(row.event, 0)) or _losses(flown, row),
        "findings": int(health["findings"].get(row.event, 0)),
        "open": health["faulty"],
        "valid": final.valid,
        "restored": flown.restored,
        "wall_s": flown.wall_s,
    }
    return values | {"failed": failures(row, values)}


def told(
    table: Table,
    row: Row,
    events: Sequence[Event],
    span_ns: tuple[int, int],
    usual: Collection[str],
) -> dict[str, Any]:
    """Return when a fault and its end were reported, what else was, and the bounds of the row.

    Parameters
    ----------
    span_ns : when the fault began and when its device recovered
    usual : codes of events that are not counted as other events
    """
    known = [e for e in events if e.severity != "info"]
    own = [e.t_ns for e in known if e.code == row.event]
    over = [
        e.t_ns
        for e in events
        if e.code == row.recovered and (row.recovered != "RECOVERED" or row.event in e.text)
    ]
    expected = {*usual, row.event, row.recovered, *row.also}
    return {
        "type": row.type,
        "event": row.event,
        "detect_s": (own[0] - span_ns[0]) * 1e-9 if own else None,
        "detect_bound_s": table.detect_bound_s(row),
        "recover_s": (over[-1] - span_ns[1]) * 1e-9 if over else None,
        "recover_bound_s": row.recover_s or table.recover_bound_s,
        "sigma_ratio_bounds": (table.sigma_least, table.sigma_ratio),
        "others": sorted({e.code for e in known} - expected),
    }


def _losses(flown: FlownRow, row: Row) -> int:
    """Return how often any link was lost if the row's event is PORT_LOST, else 0."""
    links = flown.status["links"].values() if row.event == "PORT_LOST" else ()
    return sum(int(link["losses"]) for link in links)


def failures(row: Row, values: Mapping[str, Any]) -> list[str]:
    """Return the names of the violated bounds."""
    wanted = {row.event} & set(Fault)
    recovers = row.recovered != "NONE"
    least, most = values["sigma_ratio_bounds"]
    checks = {
        "detection": values["detect_s"] is not None
        and 0.0 <= values["detect_s"] <= values["detect_bound_s"],
        "recovery": not values["open"]
        and (
            not recovers
            or (
                values["recover_s"] is not None and values["recover_s"] <= values["recover_bound_s"]
            )
        ),
        "channels": values["restored"],
        "valid": values["valid"],
        "nees": values["nees"] <= values["nees_bound"],
        "sigma": least <= values["sigma_ratio"] <= most,
        "other events": not values["others"],
        "own counter": values["counted"] > 0,
        "other counters": set(values["counters"]) <= wanted,
    }
    return [name for name, good in checks.items() if not good]
