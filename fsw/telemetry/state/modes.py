"""The mode machine: what the daemon is doing, and which telecommands go with it.

Modes are told by what is so, not by what was asked for: SAFE is latched here; otherwise a running
job is BATCH, a fed estimator IDENTIFY, neither STANDBY. Before the loop's first summary it is BOOT.
"""

from __future__ import annotations

from fsw.telemetry.dictionary.codes import Mode


class ModeMachine:
    """Follows loop, job and the safe latch."""

    def __init__(self, *, safe: bool) -> None:
        self._safe = safe
        self._identifying: bool | None = None  # None: nothing heard from the loop yet
        self._job = False

    @property
    def mode(self) -> Mode:
        """Return the mode now."""
        if self._identifying is None:
            return Mode.BOOT
        if self._safe:
            return Mode.SAFE
        if self._job:
            return Mode.BATCH
        return Mode.IDENTIFY if self._identifying else Mode.STANDBY

    def heard(self, *, identifying: bool, job: bool) -> None:
        """Take what the loop says."""
        self._identifying, self._job = identifying, job

    def identifying(self, value: bool) -> None:
        """Take what the loop has just answered."""
        self._identifying = value

    def job(self, value: bool) -> None:
        """Take whether a batch job runs."""
        self._job = value

    def latch_safe(self) -> None:
        """Enter SAFE; only a telecommand leaves it."""
        self._safe = True

    def leave_safe(self) -> None:
        """Release the latch."""
        self._safe = False
