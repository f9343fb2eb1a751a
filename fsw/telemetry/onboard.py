"""The services that work without the ground, put together: one context for all of them."""

from __future__ import annotations

from fsw.telemetry.context import TelemetryContext
from fsw.telemetry.services.executor import Handler
from fsw.telemetry.services.schedule import Schedule


class OnBoardServices:
    """The schedule."""

    def __init__(self, context: TelemetryContext) -> None:
        self.schedule = Schedule(context)

    def poll(self, now_ns: int) -> None:
        """Release what is due."""
        self.schedule.poll(now_ns)

    def digest(self) -> list[object]:
        """Return everything a telecommand can change, as plain values."""
        return [self.schedule.entries, self.schedule.enabled]

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of these services' telecommands."""
        return self.schedule.handlers()
