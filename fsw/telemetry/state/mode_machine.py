"""The mode machine: what the daemon is doing, and which telecommands the mode permits.

The mode is derived from the actual state, not from the last command. SAFE is latched here.
Otherwise the mode is BATCH while a batch job runs, IDENTIFY while the estimator receives windows,
or else STANDBY. Before the loop's first summary the mode is BOOT.
"""

from fsw.telemetry.dictionary.codes import Mode
from fsw.telemetry.state.event_reporter import EventReporter

STALE_SUMMARIES = 3  # summaries after a command's reply that may be older than the command


class ModeMachine:
    """Derives the mode from the loop, the batch job and the safe latch; reports every change."""

    def __init__(self, reporter: EventReporter, *, safe: bool) -> None:
        self._reporter = reporter
        self._safe = safe
        self._identifying: bool | None = None  # None: no summary of the loop yet
        self._job = False
        self._stale = 0  # summaries that may still contradict a command
        self._reported = self.mode

    @property
    def mode(self) -> Mode:
        """Return the present mode."""
        if self._identifying is None:
            return Mode.BOOT
        if self._safe:
            return Mode.SAFE
        if self._job:
            return Mode.BATCH
        return Mode.IDENTIFY if self._identifying else Mode.STANDBY

    def summary(self, *, identifying: bool, job: bool) -> None:
        """Record the state that the loop's summary reports.

        A reply overtakes older summaries: the first ones after it may contradict the command.
        """
        self._job = job
        if self._stale and identifying is not self._identifying:
            self._stale -= 1
        else:
            self._identifying, self._stale = identifying, 0
        self._report()

    def identifying(self, value: bool) -> None:
        """Record that the loop has resumed or paused the estimator."""
        self._identifying, self._stale = value, STALE_SUMMARIES
        self._report()

    def job(self, value: bool) -> None:
        """Record whether a batch job is running."""
        self._job = value
        self._report()

    def latch_safe(self) -> None:
        """Enter SAFE; only a telecommand ends this mode."""
        self._safe = True
        self._report()

    def leave_safe(self) -> None:
        """Release the safe latch."""
        self._safe = False
        self._report()

    def _report(self) -> None:
        if self.mode is not self._reported:
            before, self._reported = self._reported, self.mode
            self._reporter.report("MODE_CHANGED", f"{before.name} to {self.mode.name}")
