"""The daemon: one loop that brings sources, scheduler, estimator and sinks together.

`wiring.build` makes it.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from fsw.clock import Clock
from fsw.config import Config
from fsw.config.overlay import overlay
from fsw.estimators.pipeline import (
    Estimator,
    Eventful,
    Finder,
    Pipeline,
    Screening,
    default_pipeline,
)
from fsw.estimators.stages import complete
from fsw.exchange.restart import Restart, resume, take
from fsw.exchange.sinks import AppliedCommand, ScienceRecord, Sink, StatusReport
from fsw.exchange.status import estimate_summary, time_values
from fsw.health import Health
from fsw.loop.batch_work import BatchWork
from fsw.loop.bus_input import BusInput
from fsw.loop.command_queue import CommandQueue
from fsw.loop.inputs import Inputs, batch_s
from fsw.loop.line_input import LineInput
from fsw.loop.loop_status import sample_status, tick_status, window_status
from fsw.loop.science import Science
from fsw.loop.window_work import WindowWork
from fsw.messages import Estimate, Event, Window
from fsw.messages.commands import Command
from fsw.messages.errors import CommandError, EstimatorError, unforeseen
from fsw.scheduler.align import Aligner
from fsw.scheduler.executive import Executive
from fsw.scheduler.tasks import Task, Tick

WORK_SHARE = 0.25  # of a tick, after which no further unit is begun
UNITS = 4  # most of a tick, of a window that is not late


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
        passive: bool,
    ) -> None:
        self._config, self._clock, self._sink = config, clock, sink
        self._inputs = Inputs(buses, lines, clock, sink, passive=passive)
        self._pipeline = pipeline
        self._urdf_text: str | None = None  # of a robot that was uplinked
        self._windows = WindowWork(self._use)
        self.aligner = Aligner(config, len(config.joints))
        self.health = Health(config)
        telemetry = config.telemetry
        self.dispatcher = CommandQueue(
            pipeline.estimator,
            sink,
            reconfigure=self._reconfigure,
            identifying=telemetry is None or telemetry.start_mode == "identify",
        )
        self.hands_over = True  # the newest samples, where there is telemetry to take them
        self._science = None if telemetry is None or passive else Science()
        self._batch = BatchWork(
            max(1, round(config.scheduler.tick_rate_hz * batch_s(config))),
            self._inputs,
            self.aligner,
            self.health,
            self._windows,
            self._science,
            self._report,
        )
        self.latest: Estimate | None = None
        self.unusable_windows = 0
        period_ns = round(1e9 / config.scheduler.tick_rate_hz)
        budget_s = config.scheduler.work_budget_s
        self._share_ns = round(WORK_SHARE * period_ns)
        self.executive = Executive(
            clock,
            period_ns,
            self._table(),
            wake_fds=self._inputs.wake_fds,
            drain=self._inputs.stamp_lines,
            cpu_time_ns=clock.cpu_time_ns,
            stall_ns=round(config.health.stall_s * 1e9),
            budget_ns=period_ns if budget_s is None else round(budget_s * 1e9),
        )

    def step(self) -> Tick:
        """Wait for the next grid point and run one tick."""
        return self.executive.step()

    def run(self, stop: Callable[[], bool]) -> None:
        """Tick until stopped by `stop` or by a command."""
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
        self._sink.put(StatusReport(now_ns, self.status(now_ns)))
        return True

    def submit(self, command: Command) -> None:
        """Queue a command for the next tick boundary."""
        self.dispatcher.submit(command)

    def limit_windows(self, count: int) -> None:
        """Close no window from this index on; where a recorded run ended."""
        self._batch.window_limit = count

    def apply_planned(self, window: int) -> None:
        """Apply the recorded commands that came before this window, after all before it."""
        self._finish_windows()
        self._apply_planned(window)

    def _apply_planned(self, window: int) -> None:
        for estimate in self.dispatcher.before_window(window, self._clock.now_ns()):
            self._publish(estimate)

    def shutdown(self) -> Estimate | None:
        """Settle the estimator, publish the last estimate and status, release the ports."""
        now_ns = self._clock.now_ns()
        self._batch.end(now_ns)
        self._finish_windows()
        stop = {"command": "end", "next_window": self.aligner.next_index}
        self._sink.put(AppliedCommand(now_ns, stop))
        if self.latest is not None:
            self._publish(complete(self._pipeline.estimator.finishing()))
            self._keep()
        self._report("info", "STOPPED", f"stopped after {self.executive.slips.ticks} ticks")
        self._sink.put(StatusReport(now_ns, self.status(now_ns)))
        self._inputs.close()
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
        conditioner = self._pipeline.conditioner
        return {
            "t_ns": now_ns,
            **tick_status(self.executive.slips),
            **sample_status(self._config, self.aligner, self._inputs),
            "windows": window_status(self.aligner, self.unusable_windows, conditioner),
            "sampled_us": time_values(self._batch.delays),
            "published_us": time_values(self._windows.delays),
            "health": self.health.status(),
            "identifying": self.dispatcher.identifying,
            "unknown": list(self._config.unknown),
            "estimate": estimate_summary(self.latest),
        }

    def _table(self) -> list[Task]:
        rate_hz = self._config.scheduler.tick_rate_hz
        rates = {bus.name: bus for bus in self._config.buses}
        table = [Task("start", 1, self._start)]
        for bus in () if self._inputs.passive else self._inputs.buses:
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
        if period_s is not None and not self._inputs.passive:
            due = max(1, round(rate_hz * period_s))
            table.append(Task("checkpoint", due, self._checkpoint))
        return table

    def _start(self, _tick: Tick) -> None:
        self._inputs.start()

    def _sync(self, bus: BusInput, _tick: Tick) -> None:
        self._inputs.sync(bus)

    def _beat(self, bus: BusInput, _tick: Tick) -> None:
        self._inputs.beat(bus)

    def _drain(self, _tick: Tick) -> None:
        self._inputs.drain()

    def _ingest(self, tick: Tick) -> None:
        self._batch.advance(tick)

    def _estimate(self, tick: Tick) -> None:
        """Work off what has closed while the tick is young, else do one unit of what can wait.

        A backlog is worked off as far as the time goes, one window in few units a tick. Beside a
        stage of a batch nothing must be done; in a tick without one a unit always is.
        """
        if self.dispatcher.is_busy:
            return
        windows = self._windows
        free = not windows.take_fresh() and not self._batch.is_busy
        units = 0
        while windows.is_busy and (windows.is_behind or units < UNITS) and self._has_time(tick):
            self._unit()
            units += 1
        if free and not units:
            self._unit()

    def _unit(self) -> None:
        windows = self._windows
        self._guarded(windows.advance if windows.is_busy else self._pipeline.estimator.work)

    def _use(self, window: Window) -> Generator[None, None, None]:
        self._apply_planned(window.index)
        judged = self.health.judge(window)
        yield
        block = yield from self._pipeline.conditioner.stages(judged)
        if block is None:
            self.unusable_windows += 1
            return
        if not self.dispatcher.identifying or window.index < self.dispatcher.first_window:
            self._sink.put(block)
            return
        yield
        estimator = self._pipeline.estimator
        try:
            estimate = yield from estimator.stages(block)
        finally:
            # without what was found not to fit: batch jobs and checkpoints are to have the same
            self._sink.put(estimator.screened(block) if isinstance(estimator, Screening) else block)
        yield
        self._publish(estimate)
        closed_ns = window.stop_ns + round(self._config.estimator.lag_s * 1e9)
        self._windows.delays.add(self._clock.now_ns() - closed_ns)

    def _has_time(self, tick: Tick) -> bool:
        """Return whether this tick's work is short so far; simulated time does not pass in it."""
        return self._clock.now_ns() - tick.now_ns < self._share_ns

    def _finish_windows(self) -> None:
        """Work off what has been closed: a command or the end comes after all of it."""
        while self.dispatcher.is_busy:
            self._apply_queued(self._clock.now_ns(), True, lambda: True)
        while self._windows.is_busy:
            self._unit()

    def _hand_over(self, science: Science, tick: Tick) -> None:
        if not self.hands_over:
            return
        nis = self.latest.nis if self.latest is not None else 0.0
        self._sink.put(ScienceRecord(tick.now_ns, science.record(nis)))

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
        """Look at the findings as soon as a batch is worked off."""
        if not self._batch.take_decoded():
            return
        health, pipeline = self.health, self._pipeline
        health.stalled(self.executive.take_stalls(), tick.now_ns)
        health.over_budget(self.executive.take_over_budget_ns(), tick.now_ns)
        for member in self._inputs:
            health.take(member.findings(), tick.now_ns)
        # the estimator first: what does not fit the model explains what does not fit its window
        for part in (pipeline.estimator, pipeline.conditioner):
            if isinstance(part, Finder):
                health.take(part.findings(), tick.now_ns)
        health.tick(tick.index, self.executive.slips.slips, tick.now_ns)
        for event in health.events():
            self._sink.put(event)

    def _guarded(self, action: Callable[[], object]) -> None:
        try:
            action()
        except (EstimatorError, ArithmeticError, ValueError) as error:  # LinAlgError too
            self._windows.drop()
            self._pipeline.estimator.reset()
            self._report("high", "ESTIMATOR_RESET", unforeseen(error))

    def _publish(self, estimate: Estimate) -> None:
        self.latest = estimate
        self._sink.put(estimate)
        if isinstance(self._pipeline.estimator, Eventful):
            for severity, code, text in self._pipeline.estimator.events():
                self._report(severity, code, text)

    def _commands(self, tick: Tick) -> None:
        """Apply what is queued; while a window is being worked off, commands wait for its end."""
        busy = self._windows.is_busy
        self._apply_queued(tick.now_ns, busy, partial(self._has_time, tick))
        if self.dispatcher.checkpoint_due and not busy and not self.dispatcher.is_busy:
            self.dispatcher.checkpoint_due = False
            self._keep()

    def _apply_queued(self, now_ns: int, held: bool, has_time: Callable[[], bool]) -> None:
        windows = self.aligner.next_index, self.aligner.first_after(now_ns)
        for estimate in self.dispatcher.run(now_ns, *windows, held=held, has_time=has_time):
            self._publish(estimate)

    def _checkpoint(self, _tick: Tick) -> None:
        self.dispatcher.checkpoint_due = True  # and taken when no window is half worked off

    def _keep(self) -> None:
        """Hand out the estimator's state; kept by the service."""
        if self._config.service.checkpoint_period_s is None or self._inputs.passive:
            return
        now_ns = self._clock.now_ns()
        snapshot = take(self._pipeline.estimator, now_ns, self.aligner.grid_ns)
        if snapshot is not None:
            changes, identifying = tuple(self.dispatcher.changes), self.dispatcher.identifying
            self._sink.put(replace(snapshot, changes=changes, identifying=identifying))

    def _retry(self, _tick: Tick) -> None:
        self._inputs.retry()

    def _status(self, tick: Tick) -> None:
        self._sink.put(StatusReport(tick.now_ns, self.status(tick.now_ns)))

    def _report(self, severity: str, code: str, text: str) -> None:
        self._sink.put(Event(self._clock.now_ns(), severity, code, text))
