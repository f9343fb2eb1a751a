"""One row of the matrix: the run with the fault, the run it is held against, and the verdict."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from hil import bench
from hil.fault_matrix.table import Row, Table
from hil.fault_script import Place, install
from hil.inertia import pi_of
from hil.links import VirtualBench
from hil.scenario import load as load_scenario
from hil.score import normalised_error_squared

SCENARIO = "target_leo"


class Quiet:
    """A meter nobody looks at."""

    def update(self, done_s: float, summary: Mapping[str, Any] | None) -> None:
        """Show nothing."""


def prepare(table: Table, seed: int, folder: Path) -> bench.Setup:
    """Return the short motion every row uses."""
    scenario = dataclasses.replace(load_scenario(SCENARIO), before_s=table.before_s)
    setup = bench.prepare(scenario, seed, folder)
    after_s = scenario.after_s - (setup.total_s - table.total_s)
    return dataclasses.replace(setup, scenario=dataclasses.replace(scenario, after_s=after_s))


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flown:
    """A run and where its fault was."""

    recorded: bench.Recorded
    place: Place | None

    @property
    def sigma(self) -> np.ndarray:
        """1 sigma of the parameters."""
        return np.sqrt(np.diag(self.recorded.final.covariance))


def fly(table: Table, setup: bench.Setup, row: Row | None, *, reference: bool = False) -> Flown:
    """Run with a fault, with what it takes away, or clean (row None)."""
    places: list[Place] = []

    def disturb(world: VirtualBench) -> None:
        if row is not None:
            places.extend(install([table.entry(row)], world, setup.seed, reference=reference))

    recorded = bench.run_virtual(setup, Quiet(), record=False, disturb=disturb)
    return Flown(recorded=recorded, place=places[0] if places else None)


def outcome(
    table: Table, row: Row, setup: bench.Setup, run: Flown, reference: Flown, clean: Flown
) -> dict[str, Any]:
    """Return the figures of a row, and what of them is out of bounds.

    What the clean run of the same seed tells too is not the fault's doing.
    """
    recorded, place = run.recorded, run.place
    final = recorded.final
    truth = np.concatenate([pi_of(setup.scenario.truth[b]) for b in setup.scenario.unknown])
    told = [e for e in recorded.events if e.severity != "info"]
    own = [e.t_ns for e in told if e.code == row.event]
    over = [
        e.t_ns
        for e in recorded.events
        if e.code == row.recovered and (row.recovered != "RECOVERED" or row.event in e.text)
    ]
    usual = {e.code for e in clean.recorded.events}
    others = sorted({e.code for e in told} - usual - {row.event, row.recovered, *row.also})
    health = recorded.status["health"]
    counters = {name: int(n) for name, n in health["incidents"].items()}
    began_ns, returned_ns = (0, 0) if place is None else (place.began_ns, place.returned_ns)
    blocks = recorded.blocks
    last = blocks[-1]
    values = {
        "type": row.type,
        "event": row.event,
        "detect_s": (own[0] - began_ns) * 1e-9 if own else None,
        "detect_bound_s": table.detect_bound_s(row),
        "recover_s": (over[-1] - returned_ns) * 1e-9 if over else None,
        "recover_bound_s": table.recover_bound_s,
        "nees": normalised_error_squared(final.x - truth, final.covariance),
        "nees_bound": float(chi2.ppf(table.probability, len(truth))),
        "sigma_ratio": float(np.max(run.sigma / reference.sigma)),
        "sigma_ratio_bound": table.sigma_ratio,
        "others": others,
        "counters": counters,
        "findings": int(health["findings"].get(row.event, 0)),
        "open": health["faulty"],
        "valid": final.valid,
        "restored": bool(
            last.index == recorded.status["windows"]["closed"] - 1
            and last.has_joint.all()
            and last.has_gyro
            and last.has_accelerometer
        ),
        "wall_s": recorded.wall_s + reference.recorded.wall_s,
    }
    return values | {"failed": failures(row, values)}


def failures(row: Row, values: Mapping[str, Any]) -> list[str]:
    """Return which bounds do not hold."""
    wanted = set() if row.event == "PORT_LOST" else {row.event}
    checks = {
        "detection": values["detect_s"] is not None
        and 0.0 <= values["detect_s"] <= values["detect_bound_s"],
        "recovery": values["recover_s"] is not None
        and values["recover_s"] <= values["recover_bound_s"]
        and not values["open"],
        "channels": values["restored"],
        "valid": values["valid"],
        "nees": values["nees"] <= values["nees_bound"],
        "sigma": values["sigma_ratio"] <= values["sigma_ratio_bound"],
        "other events": not values["others"],
        "counters": set(values["counters"]) == wanted,
    }
    return [name for name, good in checks.items() if not good]
