"""One epoch: one daemon over many segments; each segment has new devices, errors and faults."""

import gc
import hashlib
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from evidence.soak import faults
from evidence.soak.ports import PortLane, Reversed
from fsw.exchange.recording_parts import contents_of
from fsw.exchange.sinks import Fanout, Message, NullSink
from fsw.messages import Estimate, Event
from fsw.messages.commands import Command, CommandName
from fsw.service.recorder import Parts, RecorderSink
from hil.devices.plant import Plant
from hil.judge.score import normalised_error_squared
from hil.links.virtual import VirtualBench
from hil.run.bench import Setup
from hil.run.daemon import Daemon
from hil.run.processes import resident_bytes
from hil.world.inertia import pi_of
from hil.world.sensor_config import SensorConfig

T0_NS = 10_000_000_000
REST_S = 2.0  # rest before the motion, long enough for the links to return
TAIL_S = 1.5  # rest after the motion
KEPT_PARTS = 2  # newest files of the recording that are kept
MOST_PENDING = 4096  # most items of a channel that wait for a window to close


@dataclass(frozen=True, slots=True, kw_only=True)
class SoakSegment:
    """The figures of one segment."""

    epoch: int
    number: int
    nees: float  # of the last estimate; not a number without an estimate
    valid: bool
    reason: str  # why the last estimate is not valid
    ticks: int  # of the epoch so far
    slips: int  # counted by the daemon in the epoch so far
    injected: int  # slips that the soak caused in the epoch so far
    resident_bytes: int
    faults: list[str]  # names of the faults on the links
    broken: list[str]  # violated invariants
    digest: str  # SHA-256 of all estimates and events of the epoch so far


class Watch(NullSink):
    """Checks all estimates and events of the daemon, and makes a digest of them."""

    def __init__(self) -> None:
        self.broken: list[str] = []
        self._digest = hashlib.sha256()
        self.events = 0

    def put(self, message: Message) -> None:
        """Check an estimate or count an event; ignore other messages."""
        if isinstance(message, Estimate):
            self._estimate(message)
        elif isinstance(message, Event):
            self._event(message)

    def _estimate(self, estimate: Estimate) -> None:
        self._digest.update(estimate.mean.tobytes() + estimate.covariance.tobytes())
        self._digest.update(f"{estimate.t_ns} {estimate.valid} {estimate.reason}".encode())
        if not (np.all(np.isfinite(estimate.mean)) and np.all(np.isfinite(estimate.covariance))):
            self.broken.append(f"not finite at {estimate.t_ns}")
            return
        scale = np.sqrt(np.diag(estimate.covariance))
        if np.linalg.eigvalsh(estimate.covariance / np.outer(scale, scale))[0] <= 0.0:
            self.broken.append(f"covariance not positive definite at {estimate.t_ns}")

    def _event(self, event: Event) -> None:
        """Count an event; a reset by the estimator itself or a failed recording is a fault."""
        self.events += 1
        self._digest.update(f"{event.t_ns} {event.code} {event.text}".encode())
        if event.code in ("ESTIMATOR_RESET", "RECORDER_FAILED", "DISK_FULL"):
            self.broken.append(f"{event.code}: {event.text}")

    def digest(self) -> str:
        """Return the SHA-256 (hex) of all estimates and events so far."""
        return self._digest.hexdigest()


class SoakEpoch:
    """One daemon over all segments of an epoch."""

    def __init__(
        self, setup: Setup, seed: int, number: int, folder: Path, reader: Executor
    ) -> None:
        """`reader` reads recordings in another process, so that they take no memory here."""
        self._setup, self._seed, self._number, self._reader = setup, seed, number, reader
        self._folder = folder
        self._sensors = SensorConfig.from_dict(setup.scenario.sensors)
        self._histories = (setup.history, Reversed(setup.history))
        self._watch = Watch()
        self._parts = Parts(setup.config, self._folder)
        self._recorder = RecorderSink(
            self._parts.open(),
            self._recorder_says,
            parts=self._parts.open,
            part_s=setup.config.recorder.part_s,
            part_bytes=setup.config.recorder.part_bytes,
        )
        self._lane = PortLane(self._bench(0, T0_NS))
        sink = Fanout(self._watch, self._recorder)
        self._daemon = Daemon(setup.config, self._lane, self._lane.ports(), sink)
        self._injected = 0

    def run(self, segments: int) -> Iterator[SoakSegment]:
        """Yield the segments of the epoch."""
        rate_hz = self._setup.config.scheduler.tick_rate_hz
        length_s = REST_S + self._setup.spline.duration_s + TAIL_S
        ticks = round(length_s * rate_hz)
        for k in range(segments):
            rng = np.random.default_rng((self._seed, self._number, k))
            if k:
                self._lane.exchange(self._bench(k, self._lane.now_ns()))
                self._daemon.submit(Command(name=CommandName.RESET))
            names = faults.apply(self._lane.bench, rng, length_s)
            self._fly(ticks, faults.holds(rng, ticks - 100))
            yield self._judge(k, names)
        self._daemon.shutdown()

    def _bench(self, segment: int, t0_ns: int) -> VirtualBench:
        seed = int(np.random.SeedSequence((self._seed, self._number, segment)).generate_state(1)[0])
        history = self._histories[segment % 2]
        plant = Plant(history, self._sensors, seed, start_delay_s=REST_S, t0_ns=t0_ns)
        return VirtualBench(plant, t0_ns, seed=seed)

    def _fly(self, ticks: int, holds: dict[int, int]) -> None:
        daemon, lane = self._daemon, self._lane
        period_ns = round(1e9 / self._setup.config.scheduler.tick_rate_hz)
        for tick in range(ticks):
            daemon.step()
            self._watch.broken += self._queues() if tick % 100 == 0 else []
            missed = holds.get(tick)
            due_ns = daemon.executive.next_due_ns
            if missed is not None and due_ns is not None:
                lane.hold_until_ns(due_ns + missed * period_ns + period_ns // 3)
                self._injected += missed

    def _queues(self) -> list[str]:
        daemon, config = self._daemon, self._setup.config
        waiting = {name: c.waiting for name, c in daemon.estimation.channels.items()}
        found = [f"{name}: {n} items wait" for name, n in waiting.items() if n > MOST_PENDING]
        stored = len(getattr(daemon.estimation.estimator, "blocks", ()))
        if stored > config.estimator.store_blocks:
            found.append(f"{stored} blocks stored")
        return found

    def _judge(self, number: int, names: list[str]) -> SoakSegment:
        daemon = self._daemon
        daemon.submit(Command(name=CommandName.FINISH))
        daemon.step()
        estimate, slips = daemon.latest, daemon.executive.slips
        broken, self._watch.broken = self._watch.broken, []
        if slips.slips != self._injected:
            broken.append(f"{slips.slips} slips counted, {self._injected} injected")
        nees = float("nan")
        if estimate is not None:
            truth = pi_of(self._setup.scenario.truth["target"])
            nees = normalised_error_squared(
                estimate.mean[:10] - truth, estimate.covariance[:10, :10]
            )
        broken += self._trim()
        gc.collect()
        return SoakSegment(
            epoch=self._number,
            number=number,
            nees=nees,
            valid=estimate is not None and estimate.valid,
            reason="" if estimate is None else estimate.reason,
            ticks=slips.ticks,
            slips=slips.slips,
            injected=self._injected,
            resident_bytes=resident_bytes(),
            faults=names,
            broken=broken,
            digest=self._watch.digest(),
        )

    def _trim(self) -> list[str]:
        """Check and remove all but the newest files of the recording; return the faults."""
        files = sorted(self._folder.glob("*.mcap"))
        broken = []
        for path in files[:-KEPT_PARTS]:
            if self._reader.submit(is_truncated, path).result():
                broken.append(f"{path.name}: cut off")
            path.unlink()
        return broken

    def _recorder_says(self, _severity: str, code: str, text: str) -> None:
        self._watch.broken.append(f"{code}: {text}")


def is_truncated(path: Path) -> bool:
    """Return whether a recording lacks its end record."""
    return contents_of([path]).truncated
