"""How long the daemon takes from exec to its first SYNC, beside a bare import of its libraries.

`python -m hil.evidence.speed.startup [N]` starts `fsw run` and the import in turn, N times each,
and prints both
times and their ratio. The SYNC is seen on the bus, by another process than the daemon's.
"""

import argparse
import os
import signal
import statistics
import subprocess
import sys
import time
import tty
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import can

from fsw.config import Config
from hil.devices.canopen import SYNC_ID
from hil.run.bench import prepare
from hil.run.processes import tied
from hil.world.scenario import load

IMPORTS = "import numpy, scipy.linalg, pinocchio, can, serial, yaml, pydantic"
SCENARIO = "target_leo"
TIMEOUT_S = 60.0


class StartupError(RuntimeError):
    """The daemon sent no SYNC; the message has the end of the daemon's log."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StartupPair:
    """The times of one import and of one start of the daemon to its first SYNC."""

    import_s: float
    sync_s: float

    @property
    def ratio(self) -> float:
        """The time to the first SYNC over the time of the import."""
        return self.sync_s / self.import_s


def time_import() -> float:
    """Return the time [s] that a fresh interpreter takes to import the libraries and exit."""
    began_ns = time.monotonic_ns()
    subprocess.run(tied([sys.executable, "-c", IMPORTS]), check=True, env=_environment())
    return (time.monotonic_ns() - began_ns) * 1e-9


def time_first_sync(config_path: Path, config: Config) -> float:
    """Return the time from exec of `fsw run` to the first SYNC that this process receives [s].

    Raises
    ------
    StartupError if no SYNC is received within TIMEOUT_S.
    """
    (bus,) = config.buses
    log_path = config_path.parent / "daemon.log"
    with ExitStack() as held:
        listener = held.enter_context(
            can.Bus(interface=bus.interface, channel=bus.channel, port=bus.port)
        )
        log = held.enter_context(log_path.open("w", encoding="utf-8"))
        began_ns = time.monotonic_ns()
        daemon = subprocess.Popen(
            tied([sys.executable, "-m", "fsw", "run", str(config_path)]),
            stdout=log,
            stderr=log,
            env=_environment(),
        )
        try:
            while (time.monotonic_ns() - began_ns) * 1e-9 < TIMEOUT_S and daemon.poll() is None:
                message = listener.recv(0.1)
                seen_ns = time.monotonic_ns()
                if message is not None and message.arbitration_id == SYNC_ID:
                    return (seen_ns - began_ns) * 1e-9
        finally:
            _stop(daemon)
    tail = log_path.read_text(encoding="utf-8")[-2000:]
    raise StartupError(f"no SYNC within {TIMEOUT_S} s; {log_path}: {tail}")


def measure(count: int) -> Iterator[StartupPair]:
    """Yield `count` pairs; an additional first pair fills the caches and is discarded."""
    with TemporaryDirectory(prefix="startup_") as name, ExitStack() as held:
        setup = prepare(load(SCENARIO), 0, Path(name), real_time=True)
        for device in ("imu", "star_tracker"):
            held.enter_context(_silent_line(Path(name) / device))
        for k in range(count + 1):
            pair = StartupPair(
                import_s=time_import(), sync_s=time_first_sync(setup.config_path, setup.config)
            )
            if k:
                yield pair


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print the times and their ratios; return 0."""
    parser = argparse.ArgumentParser(
        prog="python -m hil.evidence.speed.startup", description=__doc__
    )
    parser.add_argument("count", nargs="?", type=int, default=5, metavar="N")
    count = max(1, parser.parse_args(arguments).count)
    pairs = []
    for pair in measure(count):
        pairs.append(pair)
        _say(f"import {pair.import_s:.3f} s   first SYNC {pair.sync_s:.3f} s   {pair.ratio:.2f}")
    ratios = [pair.ratio for pair in pairs]
    middle = statistics.median(ratios)
    _say(f"ratio: median {middle:.2f}, min {min(ratios):.2f}, max {max(ratios):.2f} (bound 2)")
    return 0


@contextmanager
def _silent_line(link: Path) -> Iterator[None]:
    """Make a serial line at a path, with a device that sends nothing."""
    device_fd, host_fd = os.openpty()
    tty.setraw(host_fd)
    link.symlink_to(os.ttyname(host_fd))
    try:
        yield
    finally:
        os.close(device_fd)
        os.close(host_fd)


def _stop(daemon: subprocess.Popen[bytes]) -> None:
    daemon.send_signal(signal.SIGTERM)
    try:
        daemon.wait(TIMEOUT_S)
    except subprocess.TimeoutExpired:
        daemon.kill()
        daemon.wait()


def _environment() -> dict[str, str]:
    return {**os.environ, "OPENBLAS_NUM_THREADS": "1"}


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    raise SystemExit(main())
