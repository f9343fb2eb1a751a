"""The cost of telemetry, on and off in turn in one real-time run.

The plant is a process of its own, the daemon's loop runs here, its service is the flight one. A
client asks for all housekeeping sets at 10 Hz and science at 100 Hz in even seconds of the
monotonic clock, and for nothing in odd ones; the loop hands samples over in even seconds only.
What serving an idle link costs is seen beside daemons without telemetry: one before and one after
two with it, each as long, because the loop's own work changes with the phase of the motion and with
the machine's hour.
Bounds, fixed before measuring: service and loop together at most 5 % of a core more than with
telemetry off, and than without any; the 99th percentile of the tick's work at most 1.1 times that
with telemetry off; no more slips, within what chance gives.
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
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from fsw.clock import MonotonicClock
from fsw.config import load
from fsw.loop.app import open_ports
from fsw.loop.loop import Loop
from fsw.loop.processes import Processes, lock_state
from fsw.loop.wiring import build
from fsw.scheduler import realtime
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.link.packets import telecommand_packet
from hil.run import live
from hil.run.bench import prepare
from hil.run.flight import write_yaml
from hil.run.plant_document import plant_document
from hil.run.processes import tied
from hil.world.scenario import load as load_scenario

SCENARIO = "target_leo"
SECOND_NS = 1_000_000_000
EDGE_NS = 100_000_000  # time after every switch that is not counted
SETTLE_S = 8  # time for the service to start
LEAST_PACKETS = 50  # packets that show that the client receives telemetry
LOOK_NS = 500_000_000  # time between two checks of the number of packets
START_NS = 60 * SECOND_NS  # most time until the client receives telemetry
TELL_S = 10  # time between two lines of progress
ORDER = (False, True, True, False)  # whether a run has telemetry; a steady drift cancels
INTERVALS_MS = dict.fromkeys(range(1, 9), 100) | {20: 10}


@dataclass(slots=True)
class Phase:
    """Measurements over the seconds with telemetry on, or over those with telemetry off."""

    work_us: list[float] = field(default_factory=list)
    slips: int = 0
    seconds: float = 0.0
    service_cpu_s: float = 0.0
    loop_cpu_s: float = 0.0
    estimation_cpu_s: float = 0.0
    packets: int = 0  # telemetry packets that the daemon has counted as sent

    def add(self, other: Phase) -> None:
        """Add the measurements of another run."""
        for item in fields(self):
            setattr(self, item.name, getattr(self, item.name) + getattr(other, item.name))

    @property
    def p99_us(self) -> float:
        """The 99th percentile of a tick's work [us]."""
        return float(np.percentile(self.work_us, 99))

    @property
    def cpu_ratio(self) -> float:
        """Processor time of loop, estimation and service per second: the cores used."""
        return (self.service_cpu_s + self.loop_cpu_s + self.estimation_cpu_s) / self.seconds


def is_on(now_ns: int) -> bool:
    """Return whether telemetry is on in the second of a time: in even seconds."""
    return now_ns // SECOND_NS % 2 == 0


def client(port: int) -> int:
    """Enable telemetry in even seconds only and read it; return 0 at the connection's end."""
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
    """Return a connection; wait up to 60 s while the service starts. Raises LiveError."""
    for _ in range(600):
        try:
            return socket.create_connection(("127.0.0.1", port))
        except ConnectionRefusedError:
            time.sleep(0.1)
    raise live.LiveError(f"nobody listens on port {port}")


def sent_packets(state: Path) -> int:
    """Return the number of telemetry packets sent so far, from the daemon's status file."""
    status = live.read_status(state / "status.json") or {}
    return int(status.get("telemetry", {}).get("link", {}).get("tm_packets", 0))


def cpu_s(pid: int) -> float:
    """Return the processor time of a process so far [s]."""
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0]) * 1e-9


def measure(folder: Path, seconds: int, *, telemetry: bool = True) -> tuple[Phase, Phase]:
    """Return the measurements over odd (off) and even (on) seconds; no link if not `telemetry`."""
    port = free_port() if telemetry else None
    section = {"port": port, "housekeeping_interval_s": 0.0} if telemetry else None
    scenario = load_scenario(SCENARIO)
    setup = prepare(scenario, 1, folder, real_time=True, telemetry=section)
    plant = plant_document(setup.scenario, setup.seed, folder, setup.bus_ports)
    with live.started_plant(write_yaml(folder / "plant.yaml", plant), folder):
        return _fly(setup.config_path, port, seconds)


def free_port() -> int:
    """Return a TCP port that no process uses now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def _fly(path: Path, port: int | None, seconds: int) -> tuple[Phase, Phase]:
    clock, config = MonotonicClock(), load(path)
    state = config.resolve(config.service.state_directory)
    lock_state(state, clock)
    processes = Processes(config, clock, clock.now_ns())
    ports = open_ports(config, clock, processes.sink)
    loop = build(config, clock, ports, processes.sink, processes.deadline_ns)
    realtime.prepare(config.scheduler.cpu, config.scheduler.realtime_priority)
    realtime.freeze_garbage()
    phases = (Phase(), Phase())
    settled_ns = clock.now_ns() + SETTLE_S * SECOND_NS
    while clock.now_ns() < settled_ns:
        loop.step()
    with nullcontext() if port is None else _asking(loop, port, state):
        before = sent_packets(state)
        _count(loop, processes, phases, seconds)
        loop.finish()
        processes.settle(20, loop.report)
        loop.close()
        processes.service.wait(20.0)
    phases[1].packets = sent_packets(state) - before
    return phases


@contextmanager
def _asking(loop: Loop, port: int, state: Path) -> Iterator[None]:
    """Run a client process during the block; first run the loop until the client gets packets."""
    command = [sys.executable, "-m", "hil.evidence.speed.telemetry_cost", "--client", str(port)]
    with subprocess.Popen(tied(command), env=os.environ | {"OPENBLAS_NUM_THREADS": "1"}) as process:
        try:
            _tick_until_heard(loop, state)
            yield
        finally:
            process.terminate()


def _tick_until_heard(loop: Loop, state: Path) -> None:
    began_ns = look_ns = time.monotonic_ns()
    while (now_ns := time.monotonic_ns()) - began_ns < START_NS:
        loop.step()
        if now_ns >= look_ns:
            look_ns = now_ns + LOOK_NS
            if sent_packets(state) >= LEAST_PACKETS:
                return
    raise live.LiveError(f"{sent_packets(state)} packets in {START_NS / SECOND_NS:.0f} s")


def _count(loop: Loop, processes: Processes, phases: tuple[Phase, Phase], seconds: int) -> None:
    """Run the loop for `seconds`; add the measurements to the phase of each second."""
    slips, pids = loop.executive.slips, (processes.service.pid, processes.estimation.pid)
    began_ns = time.monotonic_ns()
    told_s, counting, on = 0, False, False
    before = (0, 0, 0.0, 0.0, 0.0)
    while (now_ns := time.monotonic_ns()) - began_ns < seconds * SECOND_NS:
        inside = EDGE_NS < now_ns % SECOND_NS < SECOND_NS - EDGE_NS // 4
        if inside and not counting:
            counting, on = True, is_on(now_ns)
            before = (now_ns, slips.slips, cpu_s(pids[0]), cpu_s(pids[1]), cpu_s(os.getpid()))
        elif counting and not inside:
            counting = False
            phase = phases[on]
            phase.seconds += (now_ns - before[0]) * 1e-9
            phase.slips += slips.slips - before[1]
            phase.service_cpu_s += cpu_s(pids[0]) - before[2]
            phase.estimation_cpu_s += cpu_s(pids[1]) - before[3]
            phase.loop_cpu_s += cpu_s(os.getpid()) - before[4]
            done_s = (now_ns - began_ns) // SECOND_NS
            if done_s >= told_s + TELL_S:
                told_s = done_s
                tell(f"{done_s} of {seconds} s")
        loop.step()
        if counting and inside:
            phases[on].work_us.append(slips.work.last_ns / 1e3)
        for command in processes.commands():
            processes.submit(command, loop)


def tell(text: str) -> None:
    """Write a line of progress."""
    sys.stderr.write(f"telemetry_cost: {text}\n")


def main(argv: list[str] | None = None) -> int:
    """Measure and print; return 1 if a bound is exceeded, else 0."""
    parser = argparse.ArgumentParser(prog="hil.evidence.speed.telemetry_cost", description=__doc__)
    parser.add_argument("--seconds", type=int, default=80, help="of each of four runs")
    parser.add_argument("--client", type=int, metavar="PORT", help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.client is not None:
        return client(arguments.client)
    seen = {telemetry: (Phase(), Phase()) for telemetry in ORDER}
    for number, telemetry in enumerate(ORDER):
        tell(f"run {number + 1} of {len(ORDER)}, {'with' if telemetry else 'without'} telemetry")
        with tempfile.TemporaryDirectory(prefix="cost-") as name:
            run = measure(Path(name), arguments.seconds, telemetry=telemetry)
        for pooled, phase in zip(seen[telemetry], run, strict=True):
            pooled.add(phase)
    return report(seen[False], *seen[True])


def report(without: tuple[Phase, Phase], off: Phase, on: Phase) -> int:
    """Print the table; return 1 if a bound is exceeded or too few packets were sent, else 0."""
    none = sum(phase.cpu_ratio for phase in without) / 2.0
    extra, whole, ratio = on.cpu_ratio - off.cpu_ratio, on.cpu_ratio - none, on.p99_us / off.p99_us
    chance = 3.0 * np.sqrt(off.slips + on.slips + 1.0)  # 3 sigma of the difference of two counts
    lines = [f"{'':15}{'none':>10}{'':10}{'off':>10}{'on':>10}"]
    phases = (*without, off, on)
    for name, values in (
        ("ticks", [len(p.work_us) for p in phases]),
        ("work p50 us", [float(np.median(p.work_us)) for p in phases]),
        ("work p99 us", [p.p99_us for p in phases]),
        ("packets", [p.packets for p in phases]),
        ("slips", [p.slips for p in phases]),
        ("service core", [p.service_cpu_s / p.seconds for p in phases]),
        ("estimation core", [p.estimation_cpu_s / p.seconds for p in phases]),
        ("loop core", [p.loop_cpu_s / p.seconds for p in phases]),
    ):
        lines.append(f"{name:15}" + "".join(f"{value:>10.4g}" for value in values))
    lines.append(
        f"telemetry: {extra:.1%} of a core more than off, {whole:.1%} more than none (bound 5 %); "
        f"p99 x {ratio:.3f} (bound 1.1)"
    )
    sys.stdout.write("\n".join(lines) + "\n")
    expected = 0.5 * on.seconds * (len(INTERVALS_MS) - 1) * 10.0
    if on.packets < expected:
        sys.stdout.write(f"only {on.packets} packets were sent: nothing is shown\n")
        return 1
    return int(max(extra, whole) > 0.05 or ratio > 1.1 or on.slips - off.slips > chance)


if __name__ == "__main__":
    sys.exit(main())
