"""Rows of the matrix in real time: plant and daemon are processes with links of the system.

The times of the sensors are not judged, because a bench on a busy machine is late itself; the
limits of the health monitor are wide. The reference of a row is a clean run: in real time, without
a fault. On a real bus the answers that the fault suppressed are also removed from it (see `lost`).
Both are judged at the same time of the motion. Faults reported in the clean run are not counted.
"""

import json
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.stats import chi2

from evidence.fault_matrix import lost, run
from evidence.fault_matrix.table import Row, Table
from fsw.config import load as load_config
from fsw.messages import Event
from hil.judge.outcome import result_from_json
from hil.judge.score import Result, normalised_error_squared
from hil.run import bench, live
from hil.run.flight import write_yaml
from hil.run.plant_document import plant_document
from hil.run.progress import Quiet
from hil.world.inertia import FloatArray, pi_of
from hil.world.scenario import Scenario

TIMING = ("REALTIME", "RING_DROPS", "CAN_UNSENT", "CAN_OVERFLOW", "PRIOR_CONFLICT")


@dataclass(slots=True)
class Hold:
    """The files and processes of one run, on which a fault acts."""

    folder: Path
    document: dict[str, Any]  # the flight configuration
    seed: int
    plant: int = 0  # process identifier
    daemon: int = 0  # process identifier
    stack: ExitStack = field(default_factory=ExitStack)  # is closed at the end of the run


Action = Callable[[Hold], None]


def nothing(_hold: Hold) -> None:
    """Do nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Act:
    """The actions of a fault: before the daemon starts, at the fault's beginning and at its end."""

    begin: Action = nothing
    end: Action = nothing
    before: Action = nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class Lane:
    """The conditions for rows of one lane, and the actions of their faults."""

    acts: Mapping[str, Act]  # by the type of the fault
    health: Mapping[str, Any]  # the section `health` of the flight configuration
    scenario: Scenario
    device_channel: str | None = None  # channel of the devices at the far end of a cable

    @property
    def of_the_bus(self) -> bool:
        """Whether faults suppress samples on a real bus."""
        return self.device_channel is not None


def outcomes(lane: Lane, table: Table, rows: Sequence[Row], seed: int) -> Iterator[dict[str, Any]]:
    """Run a clean run, then the rows one after the other; yield the outcome of each row."""
    with tempfile.TemporaryDirectory(prefix="hil-faults-") as home:
        clean = fly(lane, table, None, seed, Path(home) / "clean")
        for row in rows:
            flown = fly(lane, table, row, seed, Path(home) / row.type)
            sigma, missing = _sigma(clean["final"]), 0
            if lane.of_the_bus and row.loses != "nothing":
                span_ns = flown["times_ns"]["began"], flown["times_ns"]["returned"]
                config = load_config(clean["setup"].config_path)
                recordings = clean["recording"], flown["recording"]
                reference, missing = lost.reference(
                    *recordings, config, span_ns, Path(home), clean["end_ns"]
                )
                sigma = _sigma(reference)
            yield outcome(table, row, flown, clean, sigma) | {"lost": missing}
            shutil.rmtree(Path(home) / row.type)  # in `hil vcan` the files are in memory


def fly(lane: Lane, table: Table, row: Row | None, seed: int, folder: Path) -> dict[str, Any]:
    """Run in real time with the fault of a row, or clean (row None); return results and files."""
    setup = run.prepare(table, seed, folder, real_time=True, scenario=lane.scenario)
    document = yaml.safe_load(setup.config_path.read_text(encoding="utf-8"))
    document["health"] = dict(lane.health)
    plant_path = _write_plant(lane, setup)
    hold = Hold(folder, document, seed)
    act = Act() if row is None else lane.acts[row.type]
    at_s, for_s = (table.at_s, table.for_s) if row is None else table.times(row)
    times_ns: dict[str, int] = {}
    with hold.stack:
        act.before(hold)
        write_yaml(setup.config_path, document)

        def disturb(done_s: float, plant_pid: int, daemon_pid: int) -> None:
            hold.plant, hold.daemon = plant_pid, daemon_pid
            if done_s >= at_s and "began" not in times_ns:
                times_ns["began"] = time.monotonic_ns()
                act.begin(hold)
            if done_s >= at_s + for_s and "returned" not in times_ns:
                times_ns["returned"] = time.monotonic_ns()
                act.end(hold)

        outcome = live.run(setup.config_path, plant_path, setup.total_s, Quiet(), disturb)
    end_s = setup.total_s - setup.scenario.before_s
    end_ns = int(outcome.plant["origin_ns"]) + round(1e9 * end_s)
    final = live.estimate_by(outcome.recordings, end_ns)
    events = (folder / "state" / "events.jsonl").read_text(encoding="utf-8").splitlines()
    closing = live.read_status(folder / "state" / "status.json") or {}
    return {
        "setup": setup,
        "recording": outcome.recordings[-1],
        "final": result_from_json(final, setup.scenario.unknown),
        "settled": result_from_json(outcome.final, setup.scenario.unknown),
        "end_ns": end_ns,
        "status": outcome.status,
        "events": [Event(**json.loads(line)) for line in events],
        "event_counts": closing.get("event_counts", {}),
        "times_ns": times_ns,
        "wall_s": outcome.wall_s,
    }


def _write_plant(lane: Lane, setup: bench.Setup) -> Path:
    document = plant_document(setup.scenario, setup.seed, setup.folder, setup.bus_ports)
    if lane.device_channel is not None:
        link = document["links"]["buses"][0]
        link["stamped_at"], link["channel"] = link["channel"], lane.device_channel
    return write_yaml(setup.folder / "plant.yaml", document)


def _sigma(result: Result) -> FloatArray:
    return np.asarray(np.sqrt(np.diag(result.covariance)))


def outcome(
    table: Table,
    row: Row,
    flown: Mapping[str, Any],
    clean: Mapping[str, Any],
    reference_sigma: FloatArray,
) -> dict[str, Any]:
    """Return the figures of a row, and under `failed` the names of the violated bounds."""
    setup: bench.Setup = flown["setup"]
    final: Result = flown["final"]
    both = final, flown["settled"]  # at the end of the motion, and when the daemon stopped
    truth = np.concatenate([pi_of(setup.scenario.truth[b]) for b in setup.scenario.unknown])
    span_ns = flown["times_ns"]["began"], flown["times_ns"]["returned"]
    usual = {e.code for e in clean["events"]} | set(TIMING)
    health = flown["status"]["health"]
    bench_own = clean["status"]["health"]["incidents"]
    incidents = {n: int(k) for n, k in health["incidents"].items()}
    counted = incidents.get(row.event, 0) or int(flown["event_counts"].get(row.event, 0))
    values = run.told(table, row, flown["events"], span_ns, usual) | {
        "nees": max(normalised_error_squared(r.x - truth, r.covariance) for r in both),
        "nees_bound": float(chi2.ppf(table.probability, len(truth))),
        "sigma_ratio": float(np.max(_sigma(final) / reference_sigma)),
        "counters": {n: k for n, k in incidents.items() if n == row.event or n not in bench_own},
        "counted": counted,
        "findings": int(health["findings"].get(row.event, 0)),
        "open": _not_of(bench_own, health["faulty"]),
        "valid": all(r.valid for r in both),
        "restored": all(link["up"] for link in flown["status"]["links"].values()),
        "wall_s": flown["wall_s"],
        "clean": _clean(clean, truth, table.probability),
    }
    failed = run.failures(row, values)
    if not values["clean"]["good"] or row.event in values["clean"]["codes"]:
        failed.append("clean run")
    return values | {"failed": failed}


def _clean(clean: Mapping[str, Any], truth: FloatArray, probability: float) -> dict[str, Any]:
    """Return codes and NEES of the clean run, and whether the run is good enough as a reference."""
    final: Result = clean["final"]
    nees = normalised_error_squared(final.x - truth, final.covariance)
    codes = {e.code for e in clean["events"] if e.severity != "info"}
    good = final.valid and nees <= float(chi2.ppf(probability, len(truth)))
    return {"codes": sorted(codes), "nees": nees, "good": good}


def _not_of(known: Mapping[str, Any], faulty: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    """Return the open faults by subject, without the faults that the clean run has too."""
    left = {subject: [f for f in faults if f not in known] for subject, faults in faulty.items()}
    return {subject: faults for subject, faults in left.items() if faults}
