"""`hil bench`: the whole daemon in real time, alone and under load.

Each condition is a separate run with simulated devices: alone, with a process that occupies a
processor, with a batch job, or with ten telemetry clients that get fast packets. In each run,
`cyclictest` (Debian's rt-tests) shows how late the machine is with a timer of the same rate. The
figures come from the daemon's status and telemetry, and from the system's counts of its processes.
"""

import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from evidence.speed.link_delay import LinkDelays
from hil.judge.stalls import bench_stalls
from hil.run import live
from hil.run.bench import prepare
from hil.run.flight import on_frames, write_yaml
from hil.run.plant_document import plant_document
from hil.run.processes import resident_bytes, tied
from hil.run.progress import Meter
from hil.world.scenario import load as load_scenario
from offline.bench.timer import cyclictest_command, cyclictest_wakes

SETTLE_S = 6.0  # start-up, which is not counted
FRESH_NS = 500_000_000  # oldest status that goes with processor times of now
CLIENTS = 10
FAST = {"housekeeping_interval_s": 0.1, "science_interval_s": 0.01}  # for the ten clients
CONDITIONS = ("alone", "hog", "batch", "clients")
BATCH_METHOD = "rda"
HOG = "while True: pass"


@dataclass(slots=True)
class Condition:
    """The measurements of one run after start-up."""

    name: str  # one of CONDITIONS
    seconds: float = 0.0
    core_percent: dict[str, float] = field(default_factory=dict)  # by process
    resident_mb: dict[str, float] = field(default_factory=dict)  # by process
    ticks: int = 0
    slips: int = 0
    stalls: int = 0
    over_budget: int = 0  # ticks whose work exceeds the period
    release_p99_us: float = 0.0  # lateness of a wake, since the start of the daemon
    work_mean_us: float = 0.0  # since the start of the daemon
    work_p99_us: float = 0.0  # since the start of the daemon
    sampled_p99_us: float = 0.0  # from the arrival of a batch's first frame to its samples
    published_p99_us: float = 0.0  # from a window's closing to its published estimate
    sample_packet_p99_ms: float = 0.0  # age of the newest joint sample in a packet; 0: none sent
    estimate_packet_p99_ms: float = 0.0  # from a window's closing to its telemetry packet
    incidents: dict[str, int] = field(default_factory=dict)  # by event code
    bench: dict[str, Any] = field(default_factory=dict)  # stalls of the devices' process
    dropped: int = 0  # messages that the ring has lost
    lost: dict[str, int] = field(default_factory=dict)  # lost samples by source
    timer_wakes: int = 0  # wake-ups of cyclictest; 0 if it is not installed
    timer_p99_us: float = 0.0  # lateness of a wake-up of cyclictest
    timer_slips: int = 0  # grid points that cyclictest missed: k for a wake-up k periods late
    timer_stalls: int = 0  # wake-ups of cyclictest that are late enough for a stall of the loop

    @property
    def slips_per_1000(self) -> float:
        """Grid points that the loop missed, of a thousand."""
        return 1000.0 * self.slips / max(1, self.ticks + self.slips)

    @property
    def timer_slips_per_1000(self) -> float:
        """Grid points that cyclictest missed, of a thousand, counted as those of the loop."""
        return 1000.0 * self.timer_slips / max(1, self.timer_wakes + self.timer_slips)

    @property
    def timer_stalls_of_run(self) -> float:
        """Stalls of cyclictest, scaled to the number of grid points of the loop."""
        points = max(1, self.timer_wakes + self.timer_slips)
        return self.timer_stalls * (self.ticks + self.slips) / points

    @property
    def unexplained(self) -> int:
        """The number of incidents that no stall of loop or bench explains."""
        left = Counter(self.incidents) - Counter(self.bench["explains"])
        return left.total() - left["LOOP_STALLED"]

    def to_json(self) -> dict[str, Any]:
        """Return all measurements as JSON values."""
        shares = {"slips_per_1000": self.slips_per_1000}
        return asdict(self) | shares | {"timer_slips_per_1000": self.timer_slips_per_1000}

    def to_text(self) -> str:
        """Return the measurements as lines of text."""
        cores = ", ".join(f"{k} {v:.1f} %" for k, v in self.core_percent.items())
        memory = ", ".join(f"{k} {v:.0f}" for k, v in self.resident_mb.items())
        timer = stalls = release = "not measured"
        if self.timer_wakes:
            timer, stalls = f"{self.timer_slips_per_1000:.1f}", f"{self.timer_stalls_of_run:.0f}"
            release = f"{self.timer_p99_us:.0f} us"
        late = Counter(self.bench["explains"])
        incidents, late_ones = (
            ", ".join(f"{k} {v}" for k, v in counts.items()) or "none"
            for counts in (Counter(self.incidents) - late, late)
        )
        sent = ""
        if self.sample_packet_p99_ms:
            sent = f", to its packet {self.sample_packet_p99_ms:.1f} ms"
        return "\n".join(
            [
                f"{self.name}: {self.seconds:.0f} s",
                f"  core: {cores}",
                f"  memory [MB]: {memory}",
                f"  slips of 1000 ticks: {self.slips_per_1000:.1f}; of cyclictest: {timer}",
                f"  tick release: p99 {self.release_p99_us:.0f} us; of cyclictest: {release}",
                f"  work of a tick: mean {self.work_mean_us:.0f} us, p99 {self.work_p99_us:.0f} us;"
                f" {self.over_budget} over budget; {self.stalls} stalls; of cyclictest: {stalls}",
                f"  p99: frame to sample {self.sampled_p99_us / 1e3:.1f} ms{sent};"
                f" window closed to estimate published {self.published_p99_us / 1e3:.1f} ms,"
                f" to its packet {self.estimate_packet_p99_ms:.1f} ms",
                f"  bench stalled {self.bench['count']} times; incidents: {late_ones} by that,"
                f" {incidents} otherwise; lost: {sum(self.lost.values())} samples,"
                f" {self.dropped} messages",
            ]
        )


@dataclass(slots=True)
class _Look:
    """The daemon's status and the processor times at one time of the run."""

    done_s: float
    cpu_s: dict[str, float]
    status: Mapping[str, Any]


class _Watch:
    """Records processes and status during a run; calls `start` once after SETTLE_S."""

    def __init__(self, state: Path, start: Callable[[], None]) -> None:
        self._state, self._start = state, start
        self._newest_ns = 0
        self.first: _Look | None = None
        self.last: _Look | None = None
        self.resident_mb: dict[str, float] = {}

    def __call__(self, done_s: float, plant: int, daemon: int) -> None:
        if done_s < SETTLE_S:
            return
        status = live.read_status(self._state)
        if status is None or status["t_ns"] == self._newest_ns:
            return
        self._newest_ns = int(status["t_ns"])
        if time.monotonic_ns() - self._newest_ns > FRESH_NS:  # written late, by a busy service
            return
        pids = {"loop": daemon, **live.processes_of(daemon), "plant": plant}
        look = _Look(done_s, {name: _cpu_s(pid) for name, pid in pids.items()}, status)
        self.resident_mb = {name: resident_bytes(pid) / 1e6 for name, pid in pids.items()}
        if self.first is None:
            self._start()
            self.first = look
        self.last = look


def measure(
    scenario: str, name: str, seconds: float, meter: Meter, bus: str = "udp_multicast"
) -> Condition:
    """Run a scenario in real time in one condition; `bus` is udp_multicast or udp_frames.

    Raises
    ------
    LiveError if a process of the run fails.
    """
    with tempfile.TemporaryDirectory(prefix="hb-") as home, ExitStack() as stack:
        folder = Path(home)
        port = live.free_tcp_port()
        rates = FAST if name == "clients" else {}
        flown = load_scenario(scenario)
        flown = on_frames(flown) if bus == "udp_frames" else flown
        setup = prepare(flown, 0, folder, real_time=True, telemetry={"port": port, **rates})
        plant = plant_document(setup.scenario, setup.seed, folder, setup.bus_ports)
        rate_hz = setup.config.scheduler.tick_rate_hz
        priority = granted(setup.config.scheduler.realtime_priority)
        wakes: list[tuple[int, int]] = []
        clients: list[LinkDelays] = []

        def start() -> None:
            stack.enter_context(_load(name, setup.config_path, port))
            stack.enter_context(_timer(rate_hz, seconds, priority, wakes))
            clients.append(LinkDelays(port, setup.config.estimator.lag_s))

        watch = _Watch(folder / "state" / "status.json", start)
        plant_path = write_yaml(folder / "plant.yaml", plant)
        total_s = min(SETTLE_S + seconds, setup.total_s)
        outcome = live.run(setup.config_path, plant_path, total_s, meter, watch)
        for client in clients:
            client.close()
        stack.close()
        condition = _condition(name, watch, outcome.status)
        condition.timer_wakes = sum(count for _, count in wakes)
        condition.timer_p99_us = quantile(wakes, 0.99)
        condition.timer_slips = missed(wakes, 1e6 / rate_hz)
        stall_us = 1e6 * setup.config.health.stall_s
        condition.timer_stalls = sum(count for late_us, count in wakes if late_us >= stall_us)
        events = live.events_of(outcome.recordings)
        condition.bench = bench_stalls(events, outcome.plant["stalls_ns"])
        condition.sample_packet_p99_ms = clients[0].p99_ms("science")
        condition.estimate_packet_p99_ms = clients[0].p99_ms("estimate")
        return condition


def missed(wakes: Sequence[tuple[int, int]], period_us: float) -> int:
    """Return the number of grid points that wake-ups missed.

    Parameters
    ----------
    wakes : pairs of a lateness [us] and the number of wake-ups with this lateness
    """
    return sum(count * int(late_us // period_us) for late_us, count in wakes)


def quantile(wakes: Sequence[tuple[int, int]], ratio: float) -> float:
    """Return the lateness [us] that a ratio of the wake-ups did not exceed; 0 without any.

    Parameters
    ----------
    wakes : pairs of a lateness [us] and the number of wake-ups with this lateness
    """
    wanted, seen = ratio * sum(count for _, count in wakes), 0
    for late_us, count in sorted(wakes):
        seen += count
        if seen >= wanted:
            return float(late_us)
    return 0.0


def _condition(name: str, watch: _Watch, final: Mapping[str, Any]) -> Condition:
    first, last = watch.first, watch.last
    if first is None or last is None or last is first:
        raise live.LiveError(f"{name}: no two fresh statuses after {SETTLE_S:.0f} s")
    seconds = (int(last.status["t_ns"]) - int(first.status["t_ns"])) * 1e-9
    processor_s = last.done_s - first.done_s

    def grown(key: str) -> int:
        return int(last.status[key]) - int(first.status[key])

    return Condition(
        name=name,
        seconds=seconds,
        core_percent={
            k: 100.0 * (v - first.cpu_s.get(k, 0.0)) / processor_s for k, v in last.cpu_s.items()
        },
        resident_mb=watch.resident_mb,
        ticks=grown("ticks"),
        slips=grown("slips"),
        stalls=grown("stalls"),
        over_budget=grown("over_budget"),
        release_p99_us=float(last.status["release_us"]["p99"]),
        work_mean_us=float(last.status["work_us"]["mean"]),
        work_p99_us=float(last.status["work_us"]["p99"]),
        sampled_p99_us=float(last.status["sampled_us"]["p99"]),
        published_p99_us=float(last.status["published_us"]["p99"]),
        incidents=dict(last.status["health"]["incidents"]),
        dropped=int(final.get("ring", {}).get("dropped", 0)),
        lost={k: v["lost"] for k, v in last.status["samples"].items()},
    )


def granted(priority: int) -> int:
    """Return a priority of SCHED_FIFO if this process may take it as the loop does, else 0."""
    if priority == 0:
        return 0
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return 0
    os.sched_setscheduler(0, policy, parameters)
    return priority


@contextmanager
def _load(name: str, config: Path, port: int) -> Iterator[None]:
    """Keep up the load of a condition during the block."""
    with ExitStack() as stack:
        if name == "hog":
            hog = subprocess.Popen(tied([sys.executable, "-c", HOG]))
            stack.callback(hog.wait)
            stack.callback(hog.kill)
        elif name == "batch":
            command = [sys.executable, "-m", "fsw", "ctl", str(config), "run-batch"]
            with_method = [*command, f"method={BATCH_METHOD}"]
            subprocess.run(with_method, check=True, capture_output=True)
        elif name == "clients":
            for _ in range(CLIENTS):
                link = stack.enter_context(socket.create_connection(("127.0.0.1", port)))
                threading.Thread(target=_read_all, args=(link,), daemon=True).start()
        yield


def _read_all(link: socket.socket) -> None:
    """Receive until the connection ends."""
    try:
        while link.recv(1 << 16):
            pass
    except OSError:
        return


@contextmanager
def _timer(
    rate_hz: float, seconds: float, priority: int, wakes: list[tuple[int, int]]
) -> Iterator[None]:
    """Run cyclictest during the block; append pairs of a lateness [us] and a count to `wakes`."""
    command = cyclictest_command(rate_hz, 0.9 * seconds, priority)
    if command is None:
        yield
        return
    with subprocess.Popen(
        tied(command), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            yield
        finally:
            process.terminate()
            output, _ = process.communicate()
            wakes += cyclictest_wakes(output)


def _cpu_s(pid: int) -> float:
    """Return the processor time of a process so far [s]; 0 if the process has ended."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii")
    except (FileNotFoundError, ProcessLookupError):
        return 0.0
    fields = text[text.rindex(")") + 2 :].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def summary(rounds: list[list[Condition]]) -> str:
    """Return lines of text: median, least and greatest of every figure over the rounds."""
    lines = []
    for k, condition in enumerate(rounds[0]):
        runs = [conditions[k] for conditions in rounds]
        figures: dict[str, list[float]] = {
            "loop [% of a core]": [run.core_percent["loop"] for run in runs],
            "estimation [% of a core]": [run.core_percent.get("estimation", 0.0) for run in runs],
            "service [% of a core]": [run.core_percent.get("service", 0.0) for run in runs],
            "loop and estimation [% of a core]": [
                run.core_percent["loop"] + run.core_percent.get("estimation", 0.0) for run in runs
            ],
            "slips of 1000": [run.slips_per_1000 for run in runs],
            "slips of 1000, cyclictest": [run.timer_slips_per_1000 for run in runs],
            "tick release, p99 [us]": [run.release_p99_us for run in runs],
            "tick release of cyclictest, p99 [us]": [run.timer_p99_us for run in runs],
            "stalls": [float(run.stalls) for run in runs],
            "stalls, cyclictest": [run.timer_stalls_of_run for run in runs],
            "work of a tick, p99 [us]": [run.work_p99_us for run in runs],
            "work of a tick, mean [us]": [run.work_mean_us for run in runs],
            "ticks over budget": [float(run.over_budget) for run in runs],
            "samples and messages lost": [
                float(sum(run.lost.values()) + run.dropped) for run in runs
            ],
            "frame to sample, p99 [ms]": [run.sampled_p99_us / 1e3 for run in runs],
            "estimate published, p99 [ms]": [run.published_p99_us / 1e3 for run in runs],
            "estimate's packet, p99 [ms]": [run.estimate_packet_p99_ms for run in runs],
            "incidents that no stall of the bench explains": [run.unexplained for run in runs],
        }
        samples = [run.sample_packet_p99_ms for run in runs]
        if any(samples):  # science packets are sent to clients only
            figures["sample's packet, p99 [ms]"] = samples
        lines += [
            f"{condition.name}: {what} {np.median(values):.1f} ({min(values):.1f} to"
            f" {max(values):.1f})"
            for what, values in figures.items()
        ]
    return "\n".join(lines)


def as_json(rounds: list[list[Condition]]) -> str:
    """Return all runs as one JSON object."""
    return json.dumps({"rounds": [[run.to_json() for run in runs] for runs in rounds]})
