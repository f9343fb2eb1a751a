"""From batches of traffic to published estimates: decode, watch, align, condition, estimate.

The batches come through a ring (live), from a recording (replay) or from a loop in the same process
(virtual time); this module does not distinguish them. A window is processed as soon as it closes;
commands are applied between two windows.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from fsw.config import Config
from fsw.config.overlay import overlay
from fsw.drivers.layout.joints import torque_steps_nm
from fsw.errors import CommandError, EstimatorError, unforeseen
from fsw.estimation.channels import channels_of, sample_status
from fsw.estimation.dispatcher import Dispatcher
from fsw.estimation.science import Science
from fsw.estimators.pipeline import (
    Estimator,
    Eventful,
    Finder,
    Gating,
    Integrating,
    Pipeline,
    Screening,
    default_pipeline,
)
from fsw.exchange.restart import Restart, resume, take
from fsw.exchange.sinks import (
    AppliedCommand,
    BatchEnd,
    CanTraffic,
    EstimationStatus,
    Message,
    NullSink,
    ScienceRecord,
    SerialTraffic,
    Sink,
    StatusReport,
)
from fsw.exchange.status import estimate_summary, time_values
from fsw.health import Health
from fsw.messages import Estimate, Event, Window
from fsw.messages.commands import Command
from fsw.scheduler.align import Aligner
from fsw.scheduler.tasks import TaskTimes

FOREVER_NS = 1 << 62


class Estimation(NullSink):
    """Receives a loop's traffic as a sink and puts estimates, events and replies into `sink`.

    Parameters
    ----------
    now_ns : returns the time [ns]
    pipeline : conditioning and estimation; None: the configured ones
    sampled : names of the sensors whose samples another program has decoded
    replays : whether this run is a replay, without checkpoints and science records
    """

    def __init__(
        self,
        config: Config,
        now_ns: Callable[[], int],
        sink: Sink,
        *,
        pipeline: Pipeline | None = None,
        sampled: Collection[str] = (),
        replays: bool = False,
    ) -> None:
        self._config, self._now_ns, self._sink = config, now_ns, sink
        self._pipeline = pipeline or default_pipeline(config)
        self._urdf_text: str | None = None  # of an uplinked robot; None: as configured
        self.channels = channels_of(config, sampled)
        self.aligner = Aligner(config, len(config.joints))
        self.health = Health(config, torque_steps_nm(config))
        telemetry = config.telemetry
        self.dispatcher = Dispatcher(
            self._pipeline.estimator,
            sink,
            reconfigure=self._reconfigure,
            identifying=telemetry is None or telemetry.start_mode == "identify",
        )
        self._science = None if telemetry is None or replays else Science()
        rate_hz = 1.0 if telemetry is None else telemetry.science_rate_hz
        self._science_ns, self._science_next = round(1e9 / rate_hz), 0
        period_s = None if replays else config.service.checkpoint_period_s
        self._keep_ns = None if period_s is None else round(period_s * 1e9)
        self.counts_from_ns = now_ns()  # delays before this time count as start-up
        self._kept_ns = self.counts_from_ns  # when the newest checkpoint was handed out
        self.window_limit = FOREVER_NS  # no window is closed from this index on
        self.latest: Estimate | None = None
        self.unusable_windows = 0
        self._sampled, self._published = TaskTimes(), TaskTimes()
        self._end_ns: int | None = None  # end of the newest batch [ns]

    @property
    def estimator(self) -> Estimator:
        """The recursive estimator."""
        return self._pipeline.estimator

    def put(self, message: Message) -> None:
        """Accept one message: keep traffic, process a batch at its end, apply a command."""
        match message:
            case CanTraffic(bus=name) | SerialTraffic(device=name) if name in self.channels:
                self.channels[name].put(message)
            case BatchEnd():
                self._batch(message)
            case Command():
                self._apply(message)
            case StatusReport():
                self._sink.put(EstimationStatus(self.status()))
            case _:
                return

    def restart(self, found: Restart, *, recorded: bool = True) -> bool:
        """Continue from a checkpoint and publish its estimate; return False if it is refused.

        Call before the first batch. `recorded`: record the checkpoint's number for a replay.
        """
        now_ns, snapshot = self._now_ns(), found.checkpoint.snapshot
        try:
            for changes in snapshot.changes[len(self.dispatcher.changes) :]:
                self.dispatcher.configure(changes)
        except CommandError as error:
            self._report("medium", "CHECKPOINT_REFUSED", str(error))
            return False
        self.dispatcher.identifying = snapshot.identifying
        estimator = self._pipeline.estimator
        estimate = resume(found, estimator, self.aligner, self._sink, now_ns, recorded=recorded)
        if estimate is None:
            return False
        conditioner = self._pipeline.conditioner
        if found.age_s is not None and snapshot.blocks and isinstance(conditioner, Integrating):
            newest = max(snapshot.blocks, key=lambda block: block.index)
            conditioner.speeds.resume(newest, self._config.estimator.window_s)
        self.dispatcher.saved = take(estimator, snapshot.t_ns)
        self._publish(estimate)
        self._sink.put(EstimationStatus(self.status()))
        self._kept_ns = now_ns - (self._keep_ns or 0)  # the next checkpoint is due at once
        return True

    def apply_planned(self, window: int) -> None:
        """Apply the planned commands up to this window and publish the estimates they give."""
        for estimate in self.dispatcher.before_window(window, self._now_ns()):
            self._publish(estimate)

    def shutdown(self) -> Estimate | None:
        """Finish the estimator; publish status and the last estimate, and return it (or None)."""
        now_ns = self._now_ns()
        stop = {"command": "end", "next_window": self.aligner.next_index}
        self._sink.put(AppliedCommand(now_ns, stop))
        if self.latest is not None:
            self._publish(self._pipeline.estimator.finish())
            self._keep()
        self._sink.put(EstimationStatus(self.status()))
        return self.latest

    def diagnosis(self) -> Mapping[str, Any] | None:
        """Return the estimator's diagnosis as plain values; None if it cannot give one."""
        try:
            return self.dispatcher.diagnose()
        except (CommandError, EstimatorError):
            return None

    def status(self) -> dict[str, Any]:
        """Return health and counters as plain values."""
        conditioner, counters = self._pipeline.conditioner, self.aligner.counters()
        return {
            **sample_status(self._config, self.aligner, self.channels),
            "windows": {
                "closed": self.aligner.next_index,
                "unusable": self.unusable_windows,
                "outliers": conditioner.outliers if isinstance(conditioner, Gating) else 0,
                "early": counters.early,
                "future": counters.future,
                "overflow": counters.overflow,
            },
            "sampled_us": time_values(self._sampled),
            "published_us": time_values(self._published),
            "health": self.health.status(),
            "identifying": self.dispatcher.identifying,
            "unknown": list(self._config.unknown),
            "estimate": estimate_summary(self.latest),
        }

    def _batch(self, end: BatchEnd) -> None:
        """Decode the batch, process the windows that close by its end, evaluate the findings."""
        align, channels = self.aligner, self.channels.values()
        if not align.started:
            first = [t_ns for channel in channels if (t_ns := channel.first_ns()) is not None]
            if first:
                align.start(min(first))
        for channel in channels:
            for samples, known_steps in channel.decoded():
                if len(samples):
                    align.push(self.health.screen(samples) if known_steps else samples)
                    if self._science is not None:
                        self._science.keep(samples)
        if self._end_ns is not None and self.counts_from_ns <= self._end_ns < end.now_ns:
            self._sampled.add(self._now_ns() - self._end_ns)
        self._end_ns = end.now_ns
        skipped = align.skipped
        due = align.close(end.now_ns, self.window_limit)
        if align.skipped > skipped:
            self._skipped(align.skipped - skipped)
        if self.dispatcher.is_idle:
            with self._begun_again():
                self._pass_on(due)
        else:
            for window in due:
                self.work_off(window)
        self._look(end)
        self._hand_over(end.now_ns)
        if self._keep_ns is not None and end.now_ns - self._kept_ns >= self._keep_ns:
            self._keep()

    def _skipped(self, windows: int) -> None:
        self.unusable_windows += windows
        gap_s = windows * self._config.estimator.window_s
        text = f"no sample for {gap_s:.6g} s: {windows} windows skipped; did the clock jump?"
        self._report("medium", "WINDOWS_SKIPPED", text)

    def _pass_on(self, windows: Sequence[Window]) -> None:
        """Put the blocks of windows that do not reach the estimator into the sink."""
        judged = [self.health.judge(window) for window in windows]
        for block in self._pipeline.conditioner.blocks(judged):
            if block is None:
                self.unusable_windows += 1
            else:
                self._sink.put(block)

    def _use(self, window: Window) -> None:
        self.apply_planned(window.index)
        if not self.dispatcher.identifying or window.index < self.dispatcher.first_window:
            self._pass_on((window,))
            return
        (block,) = self._pipeline.conditioner.blocks((self.health.judge(window),))
        if block is None:
            self.unusable_windows += 1
            return
        estimator = self._pipeline.estimator
        try:
            estimate = estimator.push(block)
        finally:
            # without channels that screening rejected: batch jobs and checkpoints use the same data
            self._sink.put(estimator.screened(block) if isinstance(estimator, Screening) else block)
        self._publish(estimate)
        closed_ns = window.stop_ns + round(self._config.estimator.lag_s * 1e9)
        if closed_ns >= self.counts_from_ns:  # windows of the start-up do not count
            self._published.add(self._now_ns() - closed_ns)
        estimator.work()

    def _look(self, end: BatchEnd) -> None:
        """Collect the findings and turn them into events."""
        health, now_ns = self.health, end.now_ns
        health.stalled(end.stalls, now_ns)
        health.over_budget(end.over_budget_ns, now_ns)
        for channel in self.channels.values():
            channel.watch(now_ns, up=channel.name not in end.lost)
            for words in channel.events():
                self._report(*words)
            health.take(channel.findings(), now_ns)
        # estimator first: its finding about a sensor explains the conditioner's finding
        for part in (self._pipeline.estimator, self._pipeline.conditioner):
            if isinstance(part, Finder):
                health.take(part.findings(), now_ns)
        health.tick(end.tick, end.slips, now_ns)
        for event in health.events():
            self._sink.put(event)

    def _hand_over(self, now_ns: int) -> None:
        """Hand the newest samples to telemetry, at most once per science period."""
        if self._science is not None and now_ns // self._science_ns >= self._science_next:
            self._science_next = now_ns // self._science_ns + 1
            nis = self.latest.nis if self.latest is not None else 0.0
            self._sink.put(ScienceRecord(now_ns, self._science.record(nis)))

    def _apply(self, command: Command) -> None:
        now_ns = self._now_ns()
        windows = self.aligner.next_index, self.aligner.first_after(now_ns)
        estimate = self.dispatcher.apply(command, now_ns, *windows)
        if estimate is not None:
            self._publish(estimate)
        if self.dispatcher.checkpoint_due:
            self._keep()

    def _reconfigure(self, changes: Mapping[str, Any]) -> Estimator:
        """Return a new estimator at the prior, with changed unknowns, noise, robot or settings.

        Raises
        ------
        ConfigError when the changes are invalid; the old estimator then stays in use.
        """
        changed = overlay(self._config, changes)
        text = changes.get("urdf_text", self._urdf_text)
        before, self._pipeline = self._pipeline.conditioner, default_pipeline(changed, text)
        now = self._pipeline.conditioner
        if isinstance(before, Integrating) and isinstance(now, Integrating):
            now.speeds.take_over(before.speeds)
        self._config, self._urdf_text = changed, text
        return self._pipeline.estimator

    def work_off(self, window: Window) -> None:
        """Process one window; if the arithmetic fails, reset the estimator to its prior."""
        with self._begun_again():
            self._use(window)

    @contextmanager
    def _begun_again(self) -> Iterator[None]:
        try:
            yield
        except (EstimatorError, ArithmeticError, ValueError) as error:  # LinAlgError too
            self._pipeline.estimator.reset()
            self._report("high", "ESTIMATOR_RESET", unforeseen(error))

    def _publish(self, estimate: Estimate) -> None:
        self.latest = estimate
        self._sink.put(estimate)
        if isinstance(self._pipeline.estimator, Eventful):
            for severity, code, text in self._pipeline.estimator.events():
                self._report(severity, code, text)

    def _keep(self) -> None:
        """Put a snapshot of the estimator into the sink; the service stores it as a checkpoint."""
        self.dispatcher.checkpoint_due = False
        if self._keep_ns is None:
            return
        self._kept_ns = self._now_ns()
        snapshot = take(self._pipeline.estimator, self._kept_ns, self.aligner.grid_ns)
        if snapshot is not None:
            changes, identifying = tuple(self.dispatcher.changes), self.dispatcher.identifying
            self._sink.put(replace(snapshot, changes=changes, identifying=identifying))

    def _report(self, severity: str, code: str, text: str) -> None:
        self._sink.put(Event(self._now_ns(), severity, code, text))
