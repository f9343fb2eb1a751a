"""What telemetry costs, on and off in turn in one real-time run: `python -m hil.telemetry_cost`.

The plant is a process of its own, the daemon's loop runs here, its service is the flight one. A
client asks for all housekeeping sets at 10 Hz and science at 100 Hz in even seconds of the
monotonic clock, and for nothing in odd ones; the loop hands samples over in even seconds only.
Bounds, fixed before measuring: service and loop together at most 5 % of a core more; the 99th
percentile of the tick's work at most 1.1 times; no more slips, within what chance gives.
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from fsw import realtime
from fsw.app import build, open_ports
from fsw.clock import MonotonicClock
from fsw.config import load
from fsw.daemon import Daemon
from fsw.service_process import ServiceProcess, lock_state
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.packets import telecommand_packet
from hil import live
from hil.bench import prepare
from hil.flight import plant_document, write_yaml
from hil.scenario import load as load_scenario

SCENARIO = "target_leo"
SECOND_NS = 1_000_000_000
EDGE_NS = 100_000_000  # after every switch, not counted
SETTLE_S = 3
LEAST_PACKETS = 50  # before counting: the client is heard
INTERVALS_MS = dict.fromkeys(range(1, 9), 100) | {20: 10}


@dataclass(slots=True)
class Phase:
    """What was seen in the seconds of one kind."""

    work_us: list[float] = field(default_factory=list)
    slips: int = 0
    seconds: float = 0.0
    service_cpu_s: float = 0.0
    loop_cpu_s: float = 0.0
    packets: int = 0  # telemetry sent, as far as the daemon counted it

    @property
    def p99_us(self) -> float:
        """99th percentile of a tick's work [us]."""
        return float(np.percentile(self.work_us, 99))

    @property
    def cpu_ratio(self) -> float:
        """Cores used by loop and service."""
        return (self.service_cpu_s + self.loop_cpu_s) / self.seconds


def is_on(now_ns: int) -> bool:
    """Tell whether telemetry is on in this second."""
    return now_ns // SECOND_NS % 2 == 0


def client(port: int) -> int:
    """Ask in even seconds, refuse in odd ones, take what comes; until the daemon goes."""
    sequence = 0

    def tell(link: socket.socket, name: str, **values: object) -> None:
        nonlocal sequence
        sequence += 1
        packet = telecommand_packet(DICTIONARY.telecommand(name), values, sequence, ack=0)
        link.sendall(packet)

    with _connected(port) as link:
        for sid, interval_ms in INTERVALS_MS.items():
            tell(link, "SET_INTERVAL", sid=sid, interval_ms=interval_ms)
        link.settimeout(0.01)
        before: bool | None = None
        while True:
            now = is_on(time.monotonic_ns())
            if now is not before:
                before = now
                for sid in INTERVALS_MS:
                    tell(link, "ENABLE_SET" if now else "DISABLE_SET", sid=sid)
            try:
                if not link.recv(1 << 16):
                    return 0
            except TimeoutError:
                continue
            except ConnectionResetError:
                return 0


def _connected(port: int) -> socket.socket:
    """Return a connection; the service may still be starting."""
    for _ in range(600):
        try:
            return socket.create_connection(("127.0.0.1", port))
        except ConnectionRefusedError:
            time.sleep(0.1)
    raise live.LiveError(f"nobody listens on port {port}")


def sent_packets(state: Path) -> int:
    """Return the telemetry packets sent so far, by the daemon's own status file."""
    status = live.read_status(state / "status.json") or {}
    return int(status.get("telemetry", {}).get("link", {}).get("tm_packets", 0))


def cpu_s(pid: int) -> float:
    """Return the processor time of a process so far [s]."""
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0]) * 1e-9


def measure(folder: Path, seconds: int, progress: Progress) -> tuple[Phase, Phase]:
    """Return what was seen with telemetry off and on."""
    setup = prepare(load_scenario(SCENARIO), 1, folder, real_time=True)
    document = yaml.safe_load(setup.config_path.read_text())
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    document["telemetry"] = {"port": port, "housekeeping_interval_s": 0.0}
    setup.config_path.write_text(yaml.safe_dump(document))
    plant = plant_document(setup.scenario, setup.seed, folder, setup.bus_port)
    path = write_yaml(folder / "plant.yaml", plant)
    with live.process_of("plant", ["-m", "hil.plant", str(path)], folder) as process:
        live.wait_ready(process, folder)
        return _fly(setup.config_path, port, seconds, progress)


def _fly(path: Path, port: int, seconds: int, progress: Progress) -> tuple[Phase, Phase]:
    clock, config = MonotonicClock(), load(path)
    lock_state(config.resolve(config.service.state_directory), clock)
    service = ServiceProcess(config, clock)
    daemon = build(
        config, clock, open_ports(config, clock, service.sink), service.sink, jobs=service.jobs
    )
    realtime.prepare(config.scheduler)
    realtime.freeze_garbage()
    phases = (Phase(), Phase())
    state = config.resolve(config.service.state_directory)
    with _asking(daemon, port, state):
        before = sent_packets(state)
        bar = progress.add_task("on and off in turn", total=seconds)
        _count(daemon, service, phases, seconds, lambda done: progress.update(bar, completed=done))
        daemon.shutdown()
        service.wait(20.0)
    phases[1].packets = sent_packets(state) - before
    return phases


@contextmanager
def _asking(daemon: Daemon, port: int, state: Path) -> Iterator[None]:
    """Have a client of its own process while the block runs; the loop ticks until it can come."""
    deadline_ns = time.monotonic_ns() + SETTLE_S * SECOND_NS
    while time.monotonic_ns() < deadline_ns:
        daemon.step()
    command = [sys.executable, "-m", "hil.telemetry_cost", "--client", str(port)]
    with subprocess.Popen(command, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"}) as process:
        while sent_packets(state) < LEAST_PACKETS:
            daemon.step()
        yield
        process.terminate()


def _count(
    daemon: Daemon, service: ServiceProcess, phases: tuple[Phase, Phase], seconds: int, show: object
) -> None:
    """Tick for so many seconds; sort what is seen by the second's kind."""
    slips, pid = daemon.executive.slips, os.getpid()
    began_ns = time.monotonic_ns()
    end_ns = began_ns + seconds * SECOND_NS
    second, counting = -1, False
    before = (0, 0, 0.0, 0.0)
    while (now_ns := time.monotonic_ns()) < end_ns:
        on = is_on(now_ns)
        daemon.hands_over = on
        inside = EDGE_NS < now_ns % SECOND_NS < SECOND_NS - EDGE_NS // 4
        if inside and not counting:
            counting, second = True, now_ns // SECOND_NS
            before = (now_ns, slips.slips, cpu_s(service.pid), cpu_s(pid))
        elif counting and not inside:
            counting = False
            phase = phases[second % 2 == 0]
            phase.seconds += (now_ns - before[0]) * 1e-9
            phase.slips += slips.slips - before[1]
            phase.service_cpu_s += cpu_s(service.pid) - before[2]
            phase.loop_cpu_s += cpu_s(pid) - before[3]
            if callable(show):
                show((now_ns - began_ns) * 1e-9)
        daemon.step()
        if counting and inside:
            phases[on].work_us.append(slips.work.last_ns / 1e3)
        for command in service.jobs.commands():
            daemon.submit(command)


def main(argv: list[str] | None = None) -> int:
    """Measure and print; exit code 1 when a bound is missed."""
    parser = argparse.ArgumentParser(prog="hil.telemetry_cost", description=__doc__)
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--client", type=int, metavar="PORT", help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.client is not None:
        return client(arguments.client)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with (
        tempfile.TemporaryDirectory(prefix="cost-") as folder,
        Progress(*columns, console=Console(stderr=True)) as progress,
    ):
        off, on = measure(Path(folder), arguments.seconds, progress)
    return report(off, on)


def report(off: Phase, on: Phase) -> int:
    """Print the table; return 1 when a bound is missed."""
    extra, ratio = on.cpu_ratio - off.cpu_ratio, on.p99_us / off.p99_us
    chance = 3.0 * np.sqrt(off.slips + on.slips + 1.0)  # three sigma of a count's difference
    lines = [f"{'':14}{'off':>10}{'on':>10}"]
    for name, values in (
        ("ticks", [len(p.work_us) for p in (off, on)]),
        ("work p50 us", [float(np.median(p.work_us)) for p in (off, on)]),
        ("work p99 us", [p.p99_us for p in (off, on)]),
        ("packets", [p.packets for p in (off, on)]),
        ("slips", [p.slips for p in (off, on)]),
        ("service core", [p.service_cpu_s / p.seconds for p in (off, on)]),
        ("loop core", [p.loop_cpu_s / p.seconds for p in (off, on)]),
    ):
        lines.append(f"{name:14}" + "".join(f"{value:>10.4g}" for value in values))
    lines.append(f"telemetry: {extra:.1%} of a core (bound 5 %); p99 x {ratio:.3f} (bound 1.1)")
    sys.stdout.write("\n".join(lines) + "\n")
    expected = 0.5 * on.seconds * (len(INTERVALS_MS) - 1) * 10.0
    if on.packets < expected:
        sys.stdout.write(f"only {on.packets} packets were sent: nothing is shown\n")
        return 1
    return int(extra > 0.05 or ratio > 1.1 or on.slips - off.slips > chance)


if __name__ == "__main__":
    sys.exit(main())
