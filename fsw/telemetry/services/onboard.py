"""The services that work without the ground, put together: one context for all of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fsw.telemetry.dictionary.events import OTHER_ID
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.event_actions import EventActions
from fsw.telemetry.services.eventing import IDS
from fsw.telemetry.services.executor import Handler
from fsw.telemetry.services.object_check import Content, ObjectCheck
from fsw.telemetry.services.schedule import Schedule
from fsw.telemetry.services.sequences import Sequences


class OnBoardServices:
    """Schedule, actions of events, sequences, check-sums.

    Parameters
    ----------
    find : resolves a path from the ground; raises TcError
    content : content of a table; raises TcError when there is none
    """

    def __init__(
        self, context: TelemetryContext, find: Callable[[str], Path], content: Content
    ) -> None:
        self.schedule = Schedule(context)
        self.actions = EventActions(context)
        self.sequences = Sequences(context, find)
        self.checks = ObjectCheck(context, find, content)

    def poll(self, now_ns: int) -> None:
        """Release what is due."""
        self.schedule.poll(now_ns)
        self.actions.poll()
        self.sequences.poll(now_ns)
        self.checks.poll()

    def event(self, code: str) -> None:
        """Let an event release its action."""
        self.actions.event(IDS.get(code, OTHER_ID))

    def digest(self) -> list[object]:
        """Return everything a telecommand can change, as plain values."""
        schedule = [self.schedule.entries, self.schedule.enabled]
        return [schedule, self.actions.digest(), self.sequences.digest()]

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of these services' telecommands."""
        parts = (self.schedule, self.actions, self.sequences, self.checks)
        return {name: act for part in parts for name, act in part.handlers().items()}
