"""Combines the services that work without the ground."""

from fsw.telemetry.dictionary.events import IDS, OTHER_ID
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.event_actions import EventActions
from fsw.telemetry.services.executor import Handler
from fsw.telemetry.services.filing import Filing
from fsw.telemetry.services.ground_link import GroundLink
from fsw.telemetry.services.object_checksums import ObjectChecksums
from fsw.telemetry.services.playback import Playback
from fsw.telemetry.services.schedule import Schedule
from fsw.telemetry.services.sequences import Sequences
from fsw.telemetry.services.tables import Tables


class OnBoardServices:
    """Holds the schedule, the actions of events, sequences, checksums and packet stores.

    Parameters
    ----------
    filing : finds files by the names that the ground uses
    tables : returns the contents of tables for checksums
    link : limits the rate of retrieved packets
    """

    def __init__(
        self, context: TelemetryContext, filing: Filing, tables: Tables, link: GroundLink
    ) -> None:
        self.schedule = Schedule(context)
        self.actions = EventActions(context)
        self.sequences = Sequences(context, filing)
        self.checks = ObjectChecksums(context, filing, tables)
        self.playback = Playback(context, link)

    def poll(self, now_ns: int) -> None:
        """Release the telecommands that are due, and send retrieved packets."""
        self.schedule.poll(now_ns)
        self.actions.poll()
        self.sequences.poll(now_ns)
        self.playback.poll()

    def event(self, code: str) -> None:
        """Queue the action of the event with this code, if it has one."""
        self.actions.event(IDS.get(code, OTHER_ID))

    def digest(self) -> list[object]:
        """Return the state that telecommands can change, as plain values."""
        schedule = [self.schedule.entries, self.schedule.enabled]
        parts = (self.actions, self.sequences, self.playback)
        return [schedule, *(part.digest() for part in parts)]

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of these services' telecommands."""
        parts = (self.schedule, self.actions, self.sequences, self.checks, self.playback)
        return {name: act for part in parts for name, act in part.handlers().items()}
