"""One round of kills: the plant keeps running while the daemon is killed again and again."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from evidence.kills.files import part_state, unreadable_checkpoints
from evidence.kills.watch import Observer, alive, wait_for
from hil.run import live
from hil.run.bench import prepare
from hil.run.flight import write_yaml
from hil.run.live import LiveError, processes_of
from hil.run.plant_document import plant_document
from hil.run.processes import tied
from hil.world.scenario import BUS, at_rates, load

SCENARIO = "target_leo"
RATE_HZ, IMU_RATE_HZ = 100.0, 125  # low, because speed is not judged here
CHECKPOINT_S = 1.0
BOUND_RATIO = 2.5  # largest time to the restored estimate over the time of the imports
WRITE_S = 0.5  # time to write a checkpoint, which a kill can interrupt
UNFLUSHED_S = 1.5  # longest end of a recording that is not on disk: a chunk ends every second
WARM_S = 3.0  # from the first estimate to the first kill
PAUSE_S = (0.05, 2.5)  # from the return of a process to the next kill
PROCESSES = ("loop", "estimation", "service")
VICTIMS = (*PROCESSES, "both")  # both: loop and service
WEIGHTS = (0.35, 0.25, 0.2, 0.2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Kill:
    """One kill and its consequences."""

    round: int
    number: int
    victim: str  # one of VICTIMS
    at_s: float  # time of the kill since the first estimate of the round
    imports_s: float  # time that the new process needs for its imports
    back_s: float  # from the new process's start to the estimate or status that an observer sees
    ratio: float  # back_s over imports_s
    lost_s: float  # age of the restored checkpoint at the kill; 0 if only the service died
    faults: tuple[str, ...]
    late: tuple[str, ...]  # exceeded bounds of time; a busy machine may exceed them


class KilledDaemon:
    """The daemon `fsw run` with one configuration, which can be started again and again."""

    def __init__(self, config: Path, observer: Observer) -> None:
        self._config, self._observer = config, observer
        self._log = (config.parent / "daemon.log").open("ab")
        self.process: subprocess.Popen[bytes] | None = None
        self.started_ns = 0

    def start(self, *, cold: bool) -> None:
        """Start the process; `cold`: without the stored state."""
        command = [sys.executable, "-m", "fsw", "run", str(self._config)]
        self.started_ns = time.monotonic_ns()
        self.process = subprocess.Popen(
            tied([*command, *(["--cold"] if cold else [])]),
            stdout=self._log,
            stderr=self._log,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )

    @property
    def pids(self) -> dict[str, int]:
        """Identifiers of loop, estimation and service. Raises LiveError if one is missing."""
        loop = self.loop()
        pids = {"loop": loop, **processes_of(loop)}
        if len(pids) < len(PROCESSES):
            raise LiveError(f"the daemon has only {', '.join(pids)}")
        return pids

    def loop(self) -> int:
        """Return the loop's process identifier. Raises LiveError if the loop has ended."""
        if self.process is None or self.process.poll() is not None:
            raise LiveError(f"the daemon is not running; {self._config.parent / 'daemon.log'}")
        return self.process.pid

    def reap(self) -> None:
        """Wait for the end of a killed loop."""
        if self.process is not None:
            self.process.wait()

    def close(self) -> None:
        """Terminate the daemon; kill it if it does not end in time."""
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(live.STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._log.close()


class Round:
    """Plant, daemon and kills of one round; seed and round number fix the kills."""

    def __init__(self, folder: Path, number: int, seed: int) -> None:
        self._folder, self._number = folder, number
        self._rng = np.random.default_rng((seed, number))
        self._state = folder / "state"
        self._observer = Observer(self._state)
        self._seen: list[dict[str, Any]] = []
        self._checked: set[Path] = set()
        self._back_ns = 0  # time of the first estimate, then of the last return of a process

    def run(self, count: int) -> Iterator[Kill]:
        """Yield `count` kills, or fewer if the motion ends. Raises LiveError without a return."""
        setup = prepare(
            at_rates(load(SCENARIO), RATE_HZ, IMU_RATE_HZ),
            self._number,
            self._folder,
            real_time=True,
        )
        document = yaml.safe_load(setup.config_path.read_text(encoding="utf-8"))
        document["service"]["checkpoint_period_s"] = CHECKPOINT_S
        write_yaml(setup.config_path, document)
        plant = plant_document(setup.scenario, self._number, self._folder, setup.bus_ports)
        plant_path = write_yaml(self._folder / "plant.yaml", plant)
        with ExitStack() as held:
            process = held.enter_context(live.started_plant(plant_path, self._folder))
            daemon = KilledDaemon(setup.config_path, self._observer)
            held.callback(daemon.close)
            daemon.start(cold=True)
            wait_for(
                lambda: bool(daemon.loop()) and self._observer.status_since(daemon.started_ns),
                "a first estimate",
            )
            up_ns = self._back_ns = time.monotonic_ns()
            time.sleep(WARM_S)
            for k in range(count):
                if (time.monotonic_ns() - up_ns) * 1e-9 > setup.total_s:
                    return
                if process.poll() is not None:
                    raise LiveError("the plant has ended")
                time.sleep(float(self._rng.uniform(*PAUSE_S)))
                yield self._kill(daemon, k, up_ns)

    def _kill(self, daemon: KilledDaemon, number: int, up_ns: int) -> Kill:
        victim = str(self._rng.choice(VICTIMS, p=WEIGHTS))
        pids = daemon.pids
        service = pids["service"]
        self._events()
        killed_ns = time.monotonic_ns()
        for name in ("loop", "service") if victim == "both" else (victim,):
            os.kill(pids[name], signal.SIGKILL)
        lost_s = 0.0
        if victim in ("service", "estimation"):
            imports_s, back_s, faults = self._child_is_back(victim, killed_ns, pids[victim])
            if victim == "estimation":
                lost_s, faults = self._restored(killed_ns)
        else:
            daemon.reap()
            daemon.start(cold=False)
            imports_s, back_s, lost_s, faults = self._loop_is_back(daemon, killed_ns)
        back_ns = time.monotonic_ns()
        late = []
        if lost_s > CHECKPOINT_S + WRITE_S:
            late.append(f"{lost_s:.2f} s of information lost")
        ratio = back_s / imports_s if imports_s > 0 else float("inf")
        if ratio > BOUND_RATIO:
            late.append(f"back after {ratio:.2f} times the imports")
        faults += unreadable_checkpoints(self._state)
        if victim != "estimation":
            wait_for(lambda: not alive(service), "the old service has ended")
        faults += self._recordings(killed_ns, late, ended=victim == "loop")
        self._back_ns = back_ns
        return Kill(
            round=self._number,
            number=number,
            victim=victim,
            at_s=(killed_ns - up_ns) * 1e-9,
            imports_s=imports_s,
            back_s=back_s,
            ratio=ratio,
            lost_s=lost_s,
            faults=tuple(faults),
            late=tuple(late),
        )

    def _loop_is_back(
        self, daemon: KilledDaemon, killed_ns: int
    ) -> tuple[float, float, float, list[str]]:
        """Wait; return times [s] from start to restored state and to status, loss [s], faults."""
        began_ns = daemon.started_ns
        wait_for(lambda: self._observer.status_since(began_ns), "a restored estimate")
        back_s = (time.monotonic_ns() - began_ns) * 1e-9
        lost_s, faults = self._restored(began_ns, killed_ns)
        restored_ns = self._event("STATE_RESTORED", began_ns)["t_ns"]
        return (restored_ns - began_ns) * 1e-9, back_s, lost_s, faults

    def _restored(self, since_ns: int, killed_ns: int | None = None) -> tuple[float, list[str]]:
        """Wait for the restored state; return the lost time [s] and the faults of the state."""
        restored = self._event("STATE_RESTORED", since_ns)
        faults = [e["text"] for e in self._seen if e["code"] == "CHECKPOINT_REFUSED"]
        match = re.search(r"([\d.]+) s old; all of it", restored["text"])
        if match is None:
            return 0.0, [*faults, f"not restored whole: {restored['text']}"]
        before_ns = since_ns if killed_ns is None else killed_ns
        return float(match[1]) - (restored["t_ns"] - before_ns) * 1e-9, faults

    def _child_is_back(self, name: str, killed_ns: int, old: int) -> tuple[float, float, list[str]]:
        """Wait for a status after a child's return; return as `_loop_is_back` without the loss."""
        wait_for(lambda: not alive(old), f"the {name} is dead")
        back = self._event(f"{name.upper()}_BACK", killed_ns)
        lost = self._event(f"{name.upper()}_LOST", killed_ns)
        wait_for(lambda: self._observer.status_since(back["t_ns"]), f"a status after the {name}")
        imports_s = (back["t_ns"] - lost["t_ns"]) * 1e-9
        back_s = (time.monotonic_ns() - lost["t_ns"]) * 1e-9
        return imports_s, back_s, []

    def _events(self) -> None:
        self._seen = self._observer.events()

    def _event(self, code: str, since_ns: int) -> dict[str, Any]:
        """Wait for the first event of a code since a time; return the event."""
        found: list[dict[str, Any]] = []

        def seen() -> bool:
            self._seen += self._observer.events()
            found[:] = [e for e in self._seen if e["code"] == code and e["t_ns"] >= since_ns]
            return bool(found)

        wait_for(seen, f"event {code}")
        return found[0]

    def _recordings(self, killed_ns: int, late: list[str], *, ended: bool) -> list[str]:
        """Return the faults of the files whose writer has ended; add exceeded times to `late`.

        `ended`: the service lived and must have closed its file. Otherwise the last chunk may be
        missing, and a file without time for a first chunk may be empty.
        """
        self._seen += self._observer.events()
        full = any(event["code"] == "RING_DROPS" for event in self._seen)
        files = sorted((self._folder / "recording").glob("*.mcap"))
        writing = self._observer.status.get("recorder", {}).get("path")
        faults = []
        for path in files:
            if path in self._checked or str(path) == writing:
                continue
            self._checked.add(path)
            state = part_state(path, f"/can/{BUS}")
            missing_s = (killed_ns - max(state.last_ns, self._back_ns)) * 1e-9
            if ended and state.truncated:
                faults.append(f"{path.name}: not closed")
            if missing_s > UNFLUSHED_S:
                late.append(f"{path.name}: ends {missing_s:.2f} s before the kill")
            if state.gaps or (not state.syncs and missing_s > UNFLUSHED_S):
                (late if full else faults).append(
                    f"{path.name}: {state.gaps} gaps in {state.syncs} SYNCs"
                )
        return faults
