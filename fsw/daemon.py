"""The daemon: the only wiring of ports, sources, scheduler, estimator and sinks.

`build` makes it, on whatever clock, ports and sink it is given: `app.run_live` gives it the
machine's, the HIL simulated ones, a replay a recording's. There is no second daemon.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from fsw.acquisition import BusInput, ChunkSource, LineInput, LinkKeeper
from fsw.clock import Clock
from fsw.commands import Command, JobPort
from fsw.config import BusConfig, Config
from fsw.dispatch import Dispatcher, settle
from fsw.drivers.wire import BytePort, FramePort
from fsw.errors import CommandError, EstimatorError
from fsw.health import Health
from fsw.link import Link
from fsw.messages import Estimate, Event, Window
from fsw.overlay import overlay
from fsw.pipeline import Estimator, Eventful, Finder, Gating, Pipeline, default_pipeline
from fsw.restart import Restart, resume, take
from fsw.scheduler.align import Aligner
from fsw.scheduler.executive import Executive
from fsw.scheduler.tasks import Task, Tick
from fsw.science import Science
from fsw.sinks import Sink
from fsw.status import estimate_summary, source_samples, task_summary, time_values

IMU = "imu"
STAR_TRACKER = "star_tracker"
CAN = "can/"  # before the name of a bus's link
SECOND = ".redundant"  # behind a bus's name: the other one of the pair
FOREVER_NS = 1 << 62
ENDED = object()


@dataclass(frozen=True, slots=True, kw_only=True)
class Ports:
    """Open ports by name, and how to open a lost one again.

    A port that is None counts as lost. `passive`: nothing is ever sent (replay).
    """

    can: Mapping[str, FramePort | None]
    imu: BytePort | None
    star_tracker: BytePort | None = None
    can_openers: Mapping[str, Callable[[], FramePort]] = field(default_factory=dict)
    line_openers: Mapping[str, Callable[[], BytePort]] = field(default_factory=dict)
    passive: bool = False


class Daemon:
    """One loop: SYNC, drain, decode, align, estimate, commands, status."""

    def __init__(
        self,
        config: Config,
        clock: Clock,
        sink: Sink,
        *,
        buses: list[BusInput],
        lines: list[LineInput],
        pipeline: Pipeline,
        jobs: JobPort | None,
        passive: bool,
    ) -> None:
        self._config, self._clock, self._sink = config, clock, sink
        self._buses, self._lines = buses, lines
        self._members: list[BusInput | LineInput] = [*buses, *lines]
        self._pipeline = pipeline
        self._urdf_text: str | None = None  # of a robot that was uplinked
        self._keeper = LinkKeeper(clock, sink)
        self._passive = passive
        self._started = False
        self._closed: deque[Window] = deque()
        self._job: Generator[None, None, None] | None = None  # the window being worked off
        self._fresh = False  # whether a window has closed in this tick
        self._window_limit = FOREVER_NS
        self.aligner = Aligner(config, len(config.joints))
        self.health = Health(config)
        telemetry = config.telemetry
        self.dispatcher = Dispatcher(
            pipeline.estimator,
            sink,
            jobs,
            reconfigure=self._reconfigure,
            identifying=telemetry is None or telemetry.start_mode == "identify",
        )
        self.hands_over = True  # the newest samples, where there is telemetry to take them
        self._science = None if telemetry is None or passive else Science()
        self.latest: Estimate | None = None
        self.unusable_windows = 0
        self.executive = Executive(
            clock,
            round(1e9 / config.scheduler.tick_rate_hz),
            self._table(),
            wake_fds=self._wake_fds,
            drain=self._stamp_lines,
        )

    def step(self) -> Tick:
        """Wait for the next grid point and run one tick."""
        return self.executive.step()

    def run(self, stop: Callable[[], bool]) -> None:
        """Tick until told to stop, by `stop` or by command."""
        while not (stop() or self.dispatcher.stop_requested):
            self.step()

    def restart(self, found: Restart) -> bool:
        """Go on from a checkpoint, before the first tick, and publish; False: a cold start."""
        now_ns, snapshot = self._clock.now_ns(), found.checkpoint.snapshot
        try:
            for changes in snapshot.changes[len(self.dispatcher.changes) :]:
                self.dispatcher.configure(changes)
        except CommandError as error:
            self._report("medium", "CHECKPOINT_REFUSED", str(error))
            return False
        self.dispatcher.identifying = snapshot.identifying
        estimator = self._pipeline.estimator
        estimate = resume(found, estimator, self.aligner, self._sink, now_ns)
        if estimate is None:
            return False
        self.dispatcher.saved = take(estimator, snapshot.t_ns)
        self._publish(estimate)
        self._sink.status(now_ns, self.status(now_ns))
        return True

    def submit(self, command: Command) -> None:
        """Queue a command for the next tick boundary."""
        self.dispatcher.submit(command)

    def limit_windows(self, count: int) -> None:
        """Close no window from this index on; where a recorded run ended."""
        self._window_limit = count

    def apply_planned(self, window: int) -> None:
        """Apply the recorded commands that came before this window, after all before it."""
        self._finish_windows()
        self._apply_planned(window)

    def _apply_planned(self, window: int) -> None:
        for estimate in self.dispatcher.before_window(window, self._clock.now_ns()):
            self._publish(estimate)

    def shutdown(self) -> Estimate | None:
        """Settle the estimator, publish the last estimate and status, release the ports."""
        self._finish_windows()
        now_ns = self._clock.now_ns()
        stop = {"command": "end", "next_window": self.aligner.next_index}
        self._sink.command(now_ns, stop)
        if self.latest is not None:
            self._publish(settle(self._pipeline.estimator))
            self._keep()
        self._report("info", "STOPPED", f"stopped after {self.executive.slips.ticks} ticks")
        self._sink.status(now_ns, self.status(now_ns))
        for member in self._members:
            for link in member.links:
                link.close()
        self._sink.close()
        return self.latest

    def diagnosis(self) -> Mapping[str, Any] | None:
        """Return the diagnosis of the estimate; None where there is no proper one."""
        try:
            return self.dispatcher.diagnose()
        except (CommandError, EstimatorError):
            return None

    def status(self, now_ns: int) -> dict[str, Any]:
        """Return health and counters as plain values."""
        align, slips = self.aligner, self.executive.slips
        late = dict(align.late)
        for bus in self._buses:
            names = [joint.name for joint in self._config.joints if joint.bus == bus.name]
            late[bus.name] = sum(align.late[name] for name in names)
        members, conditioner = self._members, self._pipeline.conditioner
        return {
            "t_ns": now_ns,
            "ticks": slips.ticks,
            "slips": slips.slips,
            "max_late_us": slips.max_late_ns / 1e3,
            "work_us": time_values(slips.work),
            "tasks_us": task_summary(slips),
            "samples": {m.name: source_samples(m.source.counters, late[m.name]) for m in members},
            "links": self._link_summaries(),
            "buses": {bus.name: bus.summary() for bus in self._buses},
            "late_joints": {joint.name: late[joint.name] for joint in self._config.joints},
            "windows": {
                "closed": align.next_index,
                "unusable": self.unusable_windows,
                "outliers": conditioner.outliers if isinstance(conditioner, Gating) else 0,
                "early": align.early,
                "future": align.future,
                "overflow": align.overflow,
            },
            "health": self.health.status(),
            "identifying": self.dispatcher.identifying,
            "unknown": list(self._config.unknown),
            "job": self.dispatcher.job_summary(),
            "estimate": estimate_summary(self.latest),
        }

    def _link_summaries(self) -> dict[str, dict[str, int]]:
        summaries = {}
        for member in self._members:
            for link in member.links:
                summaries[link.name.removeprefix(CAN)] = link.summary()
        return summaries

    def _table(self) -> list[Task]:
        rate_hz = self._config.scheduler.tick_rate_hz
        rates = {bus.name: bus for bus in self._config.buses}
        table = [Task("start", 1, self._start)]
        for bus in [] if self._passive else self._buses:
            config = rates[bus.name]
            if config.heartbeat_s is not None:
                divisor = max(1, round(rate_hz * config.heartbeat_s))
                table.append(Task(f"heartbeat_{bus.name}", divisor, partial(self._beat, bus)))
            if config.sync == "producer":
                divisor = round(rate_hz / config.rate_hz)
                table.append(Task(f"sync_{bus.name}", divisor, partial(self._sync, bus)))
        status = max(1, round(rate_hz / self._config.service.status_rate_hz))
        telemetry = self._config.telemetry
        science = []
        if telemetry is not None and self._science is not None:
            divisor = max(1, round(rate_hz / telemetry.science_rate_hz))
            science = [Task("science", divisor, partial(self._hand_over, self._science))]
        table += [
            Task("drain", 1, self._drain),
            Task("ingest", 1, self._ingest),
            *science,
            Task("estimate", 1, self._estimate),
            Task("health", 1, self._health),
            Task("commands", 1, self._commands),
            Task("links", max(1, round(rate_hz / 10.0)), self._retry),
            Task("status", status, self._status),
        ]
        period_s = self._config.service.checkpoint_period_s
        if period_s is not None and not self._passive:
            due = max(1, round(rate_hz * period_s))
            table.append(Task("checkpoint", due, self._checkpoint))
        return table

    def _start(self, _tick: Tick) -> None:
        if self._started or self._passive:
            return
        self._started = True
        for bus in self._buses:
            self._keeper.guard(bus.link, bus.start_nodes)
        for line in self._lines:
            self._keeper.guard(line.link, line.start)

    def _sync(self, bus: BusInput, _tick: Tick) -> None:
        self._keeper.guard(bus.link, bus.send_sync)

    def _beat(self, bus: BusInput, _tick: Tick) -> None:
        self._keeper.guard(bus.link, bus.send_heartbeat)

    def _drain(self, _tick: Tick) -> None:
        for bus in self._buses:
            self._keeper.guard(bus.link, partial(bus.drain, self._sink))
            for link in bus.idle_links:
                self._keeper.guard(link, partial(bus.drain_idle, link))
            if bus.select(self._sink):
                self._keeper.guard(bus.link, bus.start_nodes)
                self._keeper.guard(bus.link, bus.send_heartbeat)
        for line in self._lines:
            self._keeper.guard(line.link, partial(line.drain, self._sink))

    def _ingest(self, tick: Tick) -> None:
        align = self.aligner
        if not align.started:
            stamps = [bus.first_sync_ns() for bus in self._buses]
            first = min((t_ns for t_ns in stamps if t_ns is not None), default=None)
            if first is None:
                self._feed(FOREVER_NS)
                return
            align.start(first)
        while (deadline_ns := align.deadline_ns) is not None:
            self._feed(deadline_ns)
            if deadline_ns > tick.now_ns or align.next_index >= self._window_limit:
                break
            self._closed += align.close(deadline_ns)
            self._fresh = True
        for bus in self._buses:
            for severity, code, text in bus.source.events():
                self._report(severity, code, text)

    def _feed(self, until_ns: int) -> None:
        push, screen = self.aligner.push, self.health.screen
        for member in self._members:
            samples = member.feed(until_ns)
            for sample in samples:
                push(screen(sample))
            if samples and self._science is not None:
                self._science.keep(samples)

    def _estimate(self, _tick: Tick) -> None:
        """Do one unit of work, none where a window has just closed; work off a backlog at once."""
        while len(self._closed) > (self._job is None):
            self._unit()
        fresh, self._fresh = self._fresh, False
        if not fresh:
            self._unit()

    def _unit(self) -> None:
        if self._job is None and self._closed:
            self._job = self._use(self._closed.popleft())
        self._guarded(self._pipeline.estimator.work if self._job is None else self._advance)

    def _advance(self) -> None:
        if self._job is not None and next(self._job, ENDED) is ENDED:
            self._job = None

    def _use(self, window: Window) -> Generator[None, None, None]:
        self._apply_planned(window.index)
        block = yield from self._pipeline.conditioner.stages(self.health.judge(window))
        if block is None:
            self.unusable_windows += 1
            return
        self._sink.block(block)
        self.dispatcher.store(block)
        if self.dispatcher.identifying:
            yield
            self._publish((yield from self._pipeline.estimator.stages(block)))

    @property
    def _busy(self) -> bool:
        """Whether a closed window waits or is half worked off."""
        return self._job is not None or bool(self._closed)

    def _finish_windows(self) -> None:
        """Work off what has been closed: a command or the end comes after all of it."""
        while self._busy:
            self._unit()

    def _hand_over(self, science: Science, tick: Tick) -> None:
        if not self.hands_over:
            return
        nis = self.latest.nis if self.latest is not None else 0.0
        self._sink.science(tick.now_ns, science.record(nis))

    def _reconfigure(self, changes: Mapping[str, Any]) -> Estimator:
        """Begin at the prior with other unknowns, noise, robot or settings.

        Raises
        ------
        ConfigError when they do not fit; then nothing has changed.
        """
        changed = overlay(self._config, changes)
        text = changes.get("urdf_text", self._urdf_text)
        self._pipeline = default_pipeline(changed, text)
        self._config, self._urdf_text = changed, text
        return self._pipeline.estimator

    def _health(self, tick: Tick) -> None:
        health, pipeline = self.health, self._pipeline
        for member in self._members:
            member.watch(tick.now_ns)
            health.take(member.source.findings(), tick.now_ns)
        # the estimator first: what does not fit the model explains what does not fit its window
        for part in (pipeline.estimator, pipeline.conditioner):
            if isinstance(part, Finder):
                health.take(part.findings(), tick.now_ns)
        health.tick(tick.index, self.executive.slips.slips, tick.now_ns)
        for event in health.events():
            self._sink.event(event)

    def _guarded(self, action: Callable[[], object]) -> None:
        try:
            action()
        except EstimatorError as error:
            self._job = None
            self._pipeline.estimator.reset()
            self._report("high", "ESTIMATOR_RESET", str(error))

    def _publish(self, estimate: Estimate) -> None:
        self.latest = estimate
        self._sink.estimate(estimate)
        if isinstance(self._pipeline.estimator, Eventful):
            for severity, code, text in self._pipeline.estimator.events():
                self._report(severity, code, text)

    def _commands(self, tick: Tick) -> None:
        """Apply what is queued; while a window is being worked off, commands wait for its end."""
        busy = self._busy
        for estimate in self.dispatcher.run(tick.now_ns, self.aligner.next_index, held=busy):
            self._publish(estimate)
        if self.dispatcher.checkpoint_due and not busy:
            self.dispatcher.checkpoint_due = False
            self._keep()

    def _checkpoint(self, _tick: Tick) -> None:
        self.dispatcher.checkpoint_due = True  # and taken when no window is half worked off

    def _keep(self) -> None:
        """Hand out the estimator's state; kept by the service."""
        if self._config.service.checkpoint_period_s is None or self._passive:
            return
        now_ns = self._clock.now_ns()
        snapshot = take(self._pipeline.estimator, now_ns, self.aligner.grid_ns)
        if snapshot is not None:
            changes, identifying = tuple(self.dispatcher.changes), self.dispatcher.identifying
            self._sink.checkpoint(replace(snapshot, changes=changes, identifying=identifying))

    def _retry(self, _tick: Tick) -> None:
        for member in self._members:
            self._keeper.retry(member)

    def _status(self, tick: Tick) -> None:
        self._sink.status(tick.now_ns, self.status(tick.now_ns))

    def _wake_fds(self) -> list[int]:
        return [fd for line in self._lines for fd in line.link.wake_fds()]

    def _stamp_lines(self) -> None:
        for line in self._lines:
            self._keeper.guard(line.link, line.stamp)

    def _report(self, severity: str, code: str, text: str) -> None:
        self._sink.event(Event(self._clock.now_ns(), severity, code, text))


def build(
    config: Config,
    clock: Clock,
    ports: Ports,
    sink: Sink,
    *,
    pipeline: Pipeline | None = None,
    jobs: JobPort | None = None,
) -> Daemon:
    """Wire one daemon; opens and sends nothing.

    Parameters
    ----------
    pipeline : conditioning and estimation; None: as the configuration says
    jobs : where batch jobs run; None: they are refused
    """
    from fsw.drivers.sources import ImuSource, StarTrackerSource

    buses = [_bus_input(config, bus, clock, ports) for bus in config.buses]

    def line(name: str, port: BytePort | None, source: ChunkSource, start: bytes) -> LineInput:
        return LineInput(name, Link(name, port, ports.line_openers.get(name)), source, start)

    lines = [line(IMU, ports.imu, ImuSource(config.imu, None, config.health), b"")]
    if config.star_tracker is not None:
        tracker = StarTrackerSource(config.star_tracker, config.health)
        lines.append(line(STAR_TRACKER, ports.star_tracker, tracker, tracker.start_bytes()))
    return Daemon(
        config,
        clock,
        sink,
        buses=buses,
        lines=lines,
        pipeline=pipeline or default_pipeline(config),
        jobs=jobs,
        passive=ports.passive,
    )


def _bus_input(config: Config, bus: BusConfig, clock: Clock, ports: Ports) -> BusInput:
    """Return the input of one bus; with its redundant one, where nodes may be commanded."""
    from fsw.drivers.codecs import canopen
    from fsw.drivers.sources import BusSelector, JointBusSource

    joints = [(i, joint) for i, joint in enumerate(config.joints) if joint.bus == bus.name]
    names = [bus.name]
    nodes: dict[int, tuple[int, bytes]] = {}
    selector = None
    if not ports.passive:
        start = canopen.NmtCommand.START
        nodes = {j.node_id: canopen.encode_nmt(start, j.node_id) for _, j in joints}
        if bus.redundant is not None:
            names.append(bus.name + SECOND)
            selector = BusSelector(bus.redundant)
    links: list[Link[FramePort]] = [
        Link(CAN + name, ports.can.get(name), ports.can_openers.get(name)) for name in names
    ]
    beat = canopen.encode_heartbeat(canopen.NmtState.OPERATIONAL, canopen.MASTER_NODE)
    source = JointBusSource(bus, joints, config.health)
    return BusInput(bus.name, nodes, links, source, clock, beat, selector)
