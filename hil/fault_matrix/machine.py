"""Faults of the machine, in real time: plant and daemon as processes, over links of the system.

Times of the sensors are not judged here (a bench on a busy machine is late itself): their patience
is set wide, and what a run is held against is a run in real time without a fault.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.stats import chi2

from hil import bench, live
from hil.fault_matrix import run
from hil.fault_matrix.table import Row, Table
from hil.flight import plant_document, write_yaml
from hil.inertia import pi_of
from hil.outcome import result_from_json
from hil.score import Result, normalised_error_squared

PATIENT = {"silent_periods": 500.0, "late_periods": 100, "jitter_s": 1.0, "tracker_late_s": 1.0}
HOG = """
import os, sys, time
os.sched_setaffinity(0, {int(sys.argv[1])})
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(60))
except PermissionError:
    pass
end = time.monotonic() + 0.7
while time.monotonic() < end:
    pass
"""
SPARE_BYTES = 1 << 20
TIMING = ("REALTIME", "RING_DROPS", "CAN_UNSENT", "CAN_OVERFLOW", "PRIOR_CONFLICT")


@dataclass(slots=True)
class Machine:
    """What a fault may take hold of."""

    folder: Path
    plant: int = 0
    daemon: int = 0
    hogs: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def service(self) -> int:
        """Process identifier of the daemon's service."""
        children = Path(f"/proc/{self.daemon}/task/{self.daemon}/children").read_text().split()
        for child in children:
            if b"fsw.service" in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
        raise live.LiveError("the daemon has no service process")


Action = Callable[[Machine], None]


def _hog(machine: Machine) -> None:
    """Take every processor, ahead of the daemon where the system allows it, for a while."""
    machine.hogs += [
        subprocess.Popen([sys.executable, "-c", HOG, str(cpu)]) for cpu in os.sched_getaffinity(0)
    ]


def _end_hogs(machine: Machine) -> None:
    for hog in machine.hogs:
        hog.kill()
        hog.wait()
    machine.hogs.clear()


def _fill(machine: Machine) -> None:
    """Let no file of the service grow beyond the recording's present size, as on a full disk."""
    recordings = (machine.folder / "recording").glob("*.mcap")
    size = max(path.stat().st_size for path in recordings)
    hard = resource.prlimit(machine.service, resource.RLIMIT_FSIZE)[1]
    resource.prlimit(machine.service, resource.RLIMIT_FSIZE, (size, hard))


def _empty(machine: Machine) -> None:
    hard = resource.prlimit(machine.service, resource.RLIMIT_FSIZE)[1]
    resource.prlimit(machine.service, resource.RLIMIT_FSIZE, (hard, hard))


def _short_of_memory(machine: Machine) -> None:
    pid = machine.service
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + SPARE_BYTES
    resource.prlimit(pid, resource.RLIMIT_AS, (limit, limit))


def _kill(machine: Machine) -> None:
    os.kill(machine.service, signal.SIGKILL)


def _hang_up(machine: Machine) -> None:
    os.kill(machine.plant, signal.SIGUSR1)


def _block_recorder(machine: Machine) -> None:
    """Put a file where the recordings' directory should be."""
    (machine.folder / "recording").write_text("")


def _unblock_recorder(machine: Machine) -> None:
    (machine.folder / "recording").unlink()


def _nothing(_machine: Machine) -> None:
    return None


ACTIONS: Mapping[str, tuple[Action, Action]] = {
    "cpu_hog": (_hog, _end_hogs),
    "disk_full": (_fill, _empty),
    "recorder_failure": (_nothing, _unblock_recorder),
    "memory_limit": (_short_of_memory, _nothing),
    "service_killed": (_kill, _nothing),
    "pty_hang_up": (_hang_up, _nothing),
}


def fly(table: Table, row: Row | None, seed: int, folder: Path) -> dict[str, Any]:
    """Run in real time, with a fault or without; return what was left behind."""
    setup = run.prepare(table, seed, folder, real_time=True)
    document = yaml.safe_load(setup.config_path.read_text(encoding="utf-8"))
    document["health"] = PATIENT
    write_yaml(setup.config_path, document)
    plant = plant_document(setup.scenario, setup.seed, folder, setup.bus_port)
    plant_path = write_yaml(folder / "plant.yaml", plant)
    machine = Machine(folder)
    begin, end = (_nothing, _nothing) if row is None else ACTIONS[row.type]
    times_ns: dict[str, int] = {}
    at_s, for_s = (table.at_s, table.for_s) if row is None else table.times(row)
    if row is not None and row.type == "recorder_failure":
        _block_recorder(machine)
        times_ns["began"] = time.monotonic_ns()

    def disturb(done_s: float, plant_pid: int, daemon_pid: int) -> None:
        machine.plant, machine.daemon = plant_pid, daemon_pid
        if done_s >= at_s and "done" not in times_ns:
            times_ns.setdefault("began", time.monotonic_ns())
            times_ns["done"] = 1
            begin(machine)
        if done_s >= at_s + for_s and "returned" not in times_ns:
            times_ns["returned"] = time.monotonic_ns()
            end(machine)

    try:
        outcome = live.run(setup.config_path, plant_path, setup.total_s, run.Quiet(), disturb)
    finally:
        _end_hogs(machine)
    events = (folder / "state" / "events.jsonl").read_text().splitlines()
    return {
        "setup": setup,
        "final": result_from_json(outcome.final, setup.scenario.unknown),
        "status": outcome.status,
        "events": [json.loads(line) for line in events],
        "times_ns": times_ns,
        "wall_s": outcome.wall_s,
    }


def outcome(
    table: Table, row: Row, flown: Mapping[str, Any], clean: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the figures of a row, and what of them is out of bounds."""
    setup: bench.Setup = flown["setup"]
    final: Result = flown["final"]
    truth = np.concatenate([pi_of(setup.scenario.truth[b]) for b in setup.scenario.unknown])
    began_ns, returned_ns = flown["times_ns"]["began"], flown["times_ns"]["returned"]
    told = [e for e in flown["events"] if e["severity"] != "info"]
    own = [e["t_ns"] for e in told if e["code"] == row.event]
    over = [e["t_ns"] for e in flown["events"] if e["code"] == row.recovered]
    usual = {e["code"] for e in clean["events"]} | set(TIMING)
    codes = {e["code"] for e in told} - usual
    sigma, usual_sigma = (np.sqrt(np.diag(r.covariance)) for r in (final, clean["final"]))
    health = flown["status"]["health"]
    values = {
        "type": row.type,
        "event": row.event,
        "detect_s": (own[0] - began_ns) * 1e-9 if own else None,
        "detect_bound_s": table.detect_bound_s(row),
        "recover_s": (over[-1] - returned_ns) * 1e-9 if over else None,
        "recover_bound_s": row.recover_s or table.recover_bound_s,
        "nees": normalised_error_squared(final.x - truth, final.covariance),
        "nees_bound": float(chi2.ppf(table.probability, len(truth))),
        "sigma_ratio": float(np.max(sigma / usual_sigma)),
        "sigma_ratio_bound": table.sigma_ratio,
        "others": sorted(codes - {row.event, row.recovered, *row.also}),
        "counters": {name: int(n) for name, n in health["incidents"].items()},
        "findings": int(health["findings"].get(row.event, 0)),
        "open": health["faulty"],
        "valid": final.valid,
        "restored": True,
        "wall_s": flown["wall_s"],
    }
    return values | {"failed": run.failures(row, values)}
