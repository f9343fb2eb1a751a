"""A real-time run of the bench with telemetry on, and what the daemon sends kept byte by byte."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hil.run import bench
from hil.run.flight import write_yaml
from hil.run.plant_document import plant_document
from hil.world.scenario import changed, load

PATIENCE_S = 180.0
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}


def wait_for(what: str, condition: Callable[[], Any], timeout_s: float = PATIENCE_S) -> Any:
    """Return the condition's value once it is true."""
    deadline_s = time.monotonic() + timeout_s
    while time.monotonic() < deadline_s:
        value = condition()
        if value:
            return value
        time.sleep(0.05)
    raise TimeoutError(what)


class LiveRun:
    """Plant and daemon as processes; a client that keeps everything that comes down."""

    def __init__(self, folder: Path, settings: Sequence[str] = ()) -> None:
        self.folder = folder
        scenario = changed(load("target_leo"), settings)
        telemetry = {"port": 0, "housekeeping_interval_s": 0.5, "science_interval_s": 0.1}
        setup = bench.prepare(scenario, 1, folder, real_time=True, telemetry=telemetry)
        self.config_path = setup.config_path
        self.scenario = setup.scenario
        plant = write_yaml(
            folder / "plant.yaml", plant_document(scenario, 1, folder, setup.bus_ports)
        )
        self._logs = [(folder / f"{name}.log").open("w") for name in ("plant", "daemon")]
        self._processes: list[subprocess.Popen[str]] = []
        self._client = threading.Thread(target=self._keep)
        self.raw = bytearray()
        self.kept: dict[str, Any] = {}  # telecommands that somebody has left on board
        self.port = 0
        try:
            self._begin(plant)
        except BaseException:
            self.close()
            raise

    @property
    def daemon(self) -> subprocess.Popen[str]:
        return self._processes[1]

    def _begin(self, plant: Path) -> None:
        ready = self._start(self._logs[0], "-m", "hil.devices", str(plant)).stdout
        assert ready is not None
        assert json.loads(ready.readline())["ready"]
        self._start(self._logs[1], "-m", "fsw", "run", str(self.config_path))
        self.port = wait_for("the daemon's port", self._told_port)
        self._client.start()

    @property
    def state(self) -> Path:
        return self.folder / "state"

    def status(self) -> dict[str, Any]:
        """Return the daemon's status file."""
        try:
            return dict(json.loads((self.state / "status.json").read_text()))
        except (OSError, ValueError):
            return {}

    def stop_daemon(self) -> None:
        """End the daemon in order; what it sent is complete then."""
        if self.daemon.poll() is None:
            self.daemon.send_signal(signal.SIGTERM)
            self.daemon.wait(PATIENCE_S)
        if self._client.ident is not None:
            self._client.join(PATIENCE_S)

    def close(self) -> None:
        """End all."""
        try:
            if len(self._processes) > 1:
                self.stop_daemon()
        finally:
            for process in self._processes:
                process.kill()
                process.communicate()
            for log in self._logs:
                log.close()

    def recording(self) -> Path:
        """Return the one recording."""
        (path,) = (self.folder / "recording").glob("*.mcap")
        return path

    def _told_port(self) -> int:
        if self.daemon.poll() is not None:
            raise RuntimeError((self.folder / "daemon.log").read_text())
        return int(self.status().get("telemetry", {}).get("port") or 0)

    def _start(self, log: Any, *arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, *arguments],
            stdout=subprocess.PIPE if log is self._logs[0] else log,
            stderr=log,
            text=True,
            env=ENVIRONMENT,
        )
        self._processes.append(process)
        return process

    def _keep(self) -> None:
        with socket.create_connection(("127.0.0.1", self.port), 10.0) as link:
            link.settimeout(PATIENCE_S)
            while data := link.recv(1 << 20):
                self.raw += data


def ground(
    live: LiveRun, *words: str, timeout_s: float = 100.0
) -> subprocess.CompletedProcess[str]:
    """Run the ground command; it has patience with a busy machine."""
    if words[0] == "tc":
        words = (*words, "--timeout", f"{timeout_s:g}")
    return subprocess.run(
        [sys.executable, "-m", "ground", "--port", str(live.port), *words],
        capture_output=True,
        text=True,
        timeout=timeout_s + 50.0,
        check=False,
        env=ENVIRONMENT,
    )
