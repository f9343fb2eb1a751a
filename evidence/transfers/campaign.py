"""Run many uploads and downloads with the `ground` program; interrupt a quarter of them.

The daemon is `fsw run` with its service process and without a plant. An interruption cuts the
cable, or kills the ground program or the daemon's service, at a random time of the transfer. After
it the transfer continues by itself; a killed ground program is continued by `ground file resume`.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from evidence.store import Store
from evidence.transfers.cable import Cable
from hil.run.bench import prepare
from hil.run.live import LiveError, processes_of
from hil.run.processes import tied
from hil.world.scenario import at_rates, load

SCENARIO, RATE_HZ, IMU_RATE_HZ = "target_leo", 100.0, 125
INTERRUPTIONS = ("cut", "ground killed", "service killed")
PERIOD, INTERRUPTED = 8, (3, 6)  # of every 8 transfers, numbers 3 (put) and 6 (get)
PIECE_BYTES = 1 << 17
SIZES_BYTES, LARGE_BYTES = (0, 2_000_000), (1_000_000, 2_000_000)  # LARGE: of interrupted ones
CUT_S = (0.2, 3.0)  # duration of a cut
INSTANT_S = (0.0, 1.0)  # from the begin of the transfer to the interruption
BOUND_S = 10.0  # most time from the return of the link to the end of the transfer
PATIENCE_S = 120.0
STATUS_S = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferResult:
    """The result of one transfer."""

    number: int
    direction: str  # put or get
    size: int  # of the file [byte]
    interruption: str  # one of INTERRUPTIONS, or empty
    exit_code: int  # of the ground program
    reason: str  # what the ground program wrote to stderr
    is_right: bool  # whether the target file has exactly the bytes of the source file
    took_s: float
    after_return_s: float  # from the return of link or program to the end; 0 without interruption

    @property
    def fault(self) -> str:
        """The fault of the transfer; empty without a fault."""
        if self.exit_code == 0 and not self.is_right:
            return "reported as good, and is not"
        if self.exit_code != 0 and not self.reason:
            return "ended without a reason"
        if self.exit_code != 0 and not self.interruption:
            return f"failed: {self.reason}"
        return ""

    @property
    def is_late(self) -> bool:
        """Whether the end after an interruption is too late; a busy machine may be too slow."""
        return self.after_return_s > BOUND_S


class TransferDaemon:
    """The daemon `fsw run` without a plant, with its files in a folder."""

    def __init__(self, folder: Path) -> None:
        telemetry = {"port": 0}
        scenario = at_rates(load(SCENARIO), RATE_HZ, IMU_RATE_HZ)
        setup = prepare(scenario, 1, folder, real_time=True, telemetry=telemetry)
        self.state = folder / "state"
        self._log = (folder / "daemon.log").open("ab")
        self._process = subprocess.Popen(
            tied([sys.executable, "-m", "fsw", "run", str(setup.config_path)]),
            stdout=self._log,
            stderr=self._log,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )

    def port(self) -> int:
        """Return the link's TCP port; 0 without one. Raises LiveError if the daemon has ended."""
        if self._process.poll() is not None:
            raise LiveError("the daemon has ended")
        try:
            status = json.loads((self.state / "status.json").read_text(encoding="utf-8"))
            return int(status["telemetry"]["port"] or 0)
        except (OSError, ValueError, KeyError):
            return 0

    def wait(self) -> None:
        """Wait for a link. Raises LiveError if the daemon opens no link in time."""
        until_s = time.monotonic() + PATIENCE_S
        while not self.port():
            if time.monotonic() > until_s:
                raise LiveError("the daemon opens no link")
            time.sleep(0.05)

    def kill_service(self) -> None:
        """Kill the service; wait for the link of the next service. Raises LiveError without one."""
        status = self.state / "status.json"
        before = status.stat().st_mtime_ns
        old = processes_of(self._process.pid)["service"]
        os.kill(old, signal.SIGKILL)
        status.write_text("{}", encoding="utf-8")  # it held the port of the killed service
        until_s = time.monotonic() + PATIENCE_S
        while status.stat().st_mtime_ns == before or not self.port():
            if time.monotonic() > until_s:
                raise LiveError("the service does not come back")
            time.sleep(0.05)

    def close(self) -> None:
        """Terminate the daemon; kill it if it does not end in time."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(STATUS_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._log.close()


def campaign(count: int, folder: Path, seed: int) -> Iterator[TransferResult]:
    """Run and yield transfers until the folder has `count`.

    Raises
    ------
    LiveError if the daemon does not return. ScenarioError if the folder has another seed.
    """
    store = Store(folder, {"seed": seed})
    done = len(store.rows)
    if done >= count:
        return
    place = folder / f"run_{done:05d}"
    place.mkdir(exist_ok=True)
    with ExitStack() as stack:
        daemon = TransferDaemon(place)
        stack.callback(daemon.close)
        daemon.wait()
        cable = Cable(daemon.port)
        stack.callback(cable.close)
        for number in range(done, count):
            result = Exchange(daemon, cable, place, number, seed).run()
            store.add(str(number), asdict(result))
            yield result


class Exchange:
    """One transfer and its interruption."""

    def __init__(
        self, daemon: TransferDaemon, cable: Cable, place: Path, number: int, seed: int
    ) -> None:
        self._daemon, self._cable, self._number = daemon, cable, number
        self._place, self._rng = place, np.random.default_rng((seed, number))
        self._port = cable.port

    def run(self) -> TransferResult:
        """Run the transfer with its interruption; return the result."""
        rng, number = self._rng, self._number
        direction = "put" if number % 2 else "get"
        sizes = LARGE_BYTES if number % PERIOD in INTERRUPTED else SIZES_BYTES
        data = rng.bytes(int(rng.integers(*sizes)))
        here, there = self._place / f"{number}.bin", self._daemon.state / "files" / f"{number}.bin"
        source, target = (here, there) if direction == "put" else (there, here)
        source.write_bytes(data)
        words = (
            ["put", str(here)] if direction == "put" else ["get", f"files/{here.name}", str(here)]
        )
        interruption = ""
        if number % PERIOD in INTERRUPTED:
            interruption = INTERRUPTIONS[int(rng.integers(len(INTERRUPTIONS)))]
        begun_s = time.monotonic()
        process = self._ground(*words)
        interruption = self._until_instant(process, interruption)
        returned_s, process = self._interrupt(process, interruption)
        reason = process.communicate(timeout=PATIENCE_S)[1].strip()
        ended_s = time.monotonic()
        is_right = target.exists() and target.read_bytes() == data
        if process.returncode == 0:
            source.unlink()
            target.unlink(missing_ok=True)
        return TransferResult(
            number=number,
            direction=direction,
            size=len(data),
            interruption=interruption,
            exit_code=process.returncode,
            reason=reason,
            is_right=is_right,
            took_s=ended_s - begun_s,
            after_return_s=ended_s - returned_s if interruption else 0.0,
        )

    def _interrupt(
        self, process: subprocess.Popen[str], kind: str
    ) -> tuple[float, subprocess.Popen[str]]:
        """Interrupt; return the time of the link's return [s] and the program that continues."""
        if not kind:
            return time.monotonic(), process
        if kind == "cut":
            self._cable.cut()
            time.sleep(float(self._rng.uniform(*CUT_S)))
            self._cable.mend()
        elif kind == "service killed":
            self._daemon.kill_service()
        else:
            process.kill()
            process.communicate()
            if not list((self._place / "ground" / "transfers").glob("*.json")):
                return time.monotonic(), self._ground("list", "files")  # already over
            process = self._ground("resume")
        return time.monotonic(), process

    def _until_instant(self, process: subprocess.Popen[str], kind: str) -> str:
        """Wait for the time of the interruption; return its kind, or "" if the transfer is over."""
        if not kind:
            return ""
        records = self._place / "ground" / "transfers"
        while process.poll() is None and not list(records.glob("*.json")):
            time.sleep(0.01)
        time.sleep(float(self._rng.uniform(*INSTANT_S)))
        return "" if process.poll() is not None else kind

    def _ground(self, *words: str) -> subprocess.Popen[str]:
        options = ["--port", str(self._port), "--state", str(self._place / "ground")]
        piece = ["--timeout", str(PATIENCE_S / 2), "--piece", str(PIECE_BYTES)]
        return subprocess.Popen(
            tied([sys.executable, "-m", "ground", *options, "file", *piece, *words]),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )


def summary(store: Store) -> dict[str, Any]:
    """Return the counts, the longest times, and every fault of the transfers in a store."""
    results = [TransferResult(**row) for row in store.rows.values()]
    found: dict[str, Any] = {"transfers": len(results), "bytes": sum(r.size for r in results)}
    for kind in ("", *INTERRUPTIONS):
        of_kind = [r for r in results if r.interruption == kind]
        found[kind or "undisturbed"] = {
            "transfers": len(of_kind),
            "right": sum(r.exit_code == 0 and r.is_right for r in of_kind),
            "longest_s": max((r.after_return_s or r.took_s for r in of_kind), default=0.0),
        }
    found["with_reason"] = [r.reason for r in results if r.exit_code != 0]
    found["late"] = [r.number for r in results if r.is_late]
    found["faults"] = [{"number": r.number, "fault": r.fault} for r in results if r.fault]
    return found
