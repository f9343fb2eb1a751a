"""The services that work without the ground, put together: one context for all of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fsw.config.telemetry import PacketStoresConfig
from fsw.telemetry.dictionary.events import OTHER_ID
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.event_actions import EventActions
from fsw.telemetry.services.eventing import IDS
from fsw.telemetry.services.executor import Handler
from fsw.telemetry.services.object_check import Content, ObjectCheck
from fsw.telemetry.services.playback import Outlet, Playback
from fsw.telemetry.services.schedule import Schedule
from fsw.telemetry.services.sequences import Sequences


class OnBoardServices:
    """Schedule, actions of events, sequences, check-sums, packet stores.

    Parameters
    ----------
    find : resolves a path from the ground; raises TcError
    content : content of a table; raises TcError when there is none
    sizes : of the packet stores
    outlet : where retrieved packets go
    """

    def __init__(
        self,
        context: TelemetryContext,
        find: Callable[[str], Path],
        content: Content,
        sizes: PacketStoresConfig,
        outlet: Outlet,
    ) -> None:
        self.schedule = Schedule(context)
        self.actions = EventActions(context)
        self.sequences = Sequences(context, find)
        self.checks = ObjectCheck(context, find, content)
        self.playback = Playback(context, sizes, outlet)

    def poll(self, now_ns: int) -> None:
        """Release what is due."""
        self.schedule.poll(now_ns)
        self.actions.poll()
        self.sequences.poll(now_ns)
        self.checks.poll()
        self.playback.poll()

    def event(self, code: str) -> None:
        """Let an event release its action."""
        self.actions.event(IDS.get(code, OTHER_ID))

    def digest(self) -> list[object]:
        """Return everything a telecommand can change, as plain values."""
        schedule = [self.schedule.entries, self.schedule.enabled]
        parts = (self.actions, self.sequences, self.playback)
        return [schedule, *(part.digest() for part in parts)]

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of these services' telecommands."""
        parts = (self.schedule, self.actions, self.sequences, self.checks, self.playback)
        return {name: act for part in parts for name, act in part.handlers().items()}
