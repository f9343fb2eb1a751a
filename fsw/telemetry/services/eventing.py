"""Service 5: events, their ring log, per-event throttle and switch."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

from fsw.messages import Event
from fsw.telemetry.dictionary import DICTIONARY, Severity
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.dictionary.events import OTHER_ID
from fsw.telemetry.dictionary.reports import DISABLED_SLOTS
from fsw.telemetry.dumps import Dumps, Entries
from fsw.telemetry.event_log import FairLog
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.executor import Action, Done, Handler, Send

LOG_ENTRIES = 1000
IDS = {event.code: event.id for event in DICTIONARY.events}
SEVERITIES = {event.code: event.severity.name.lower() for event in DICTIONARY.events}


@dataclass(slots=True)
class _Track:
    """What is known of one event."""

    count: int = 0
    since_ns: int = 0  # when the throttle's period began
    sent: int = 0  # in this period
    suppressed: int = 0  # since the last that went out
    enabled: bool = True


class Eventing:
    """Logs every event, reports those that are enabled and not too many.

    Parameters
    ----------
    send_at : makes a packet with the event's own time: name, time [ns], values
    throttle : events of one number that go out, and the period it counts in [s]
    """

    def __init__(
        self,
        send_at: Callable[[str, int, Mapping[str, object]], None],
        send: Send,
        throttle: Callable[[], tuple[int, float]],
        dumps: Dumps,
    ) -> None:
        self._send_at, self._send, self._throttle = send_at, send, throttle
        self._dumps = dumps
        self._tracks: dict[int, _Track] = {}
        self._log: FairLog[Event] = FairLog(LOG_ENTRIES)
        self.total = 0
        self.suppressed = 0

    @property
    def disabled(self) -> list[int]:
        """Return events that are not reported."""
        return sorted(number for number, track in self._tracks.items() if not track.enabled)

    def take(self, event: Event) -> None:
        """Log an event; report it."""
        self._log.add(event.code, event)
        self.total += 1
        number, text = _identify(event)
        track = self._tracks.setdefault(number, _Track())
        track.count += 1
        limit, period_s = self._throttle()
        if event.t_ns - track.since_ns >= period_s * 1e9:
            track.since_ns, track.sent = event.t_ns, 0
        if not track.enabled or track.sent >= limit:
            track.suppressed += 1
            self.suppressed += 1
            return
        track.sent += 1
        values = {
            "event": number,
            "occurrence": track.count,
            "suppressed": track.suppressed,
            "text": text,
        }
        track.suppressed = 0
        self._send_at(f"event_{event.severity}", event.t_ns, values)

    def reset_counters(self) -> None:
        """Set counts to zero; the log stays."""
        self.total = self.suppressed = 0
        for track in self._tracks.values():
            track.count = 0

    def dump(self, entries: int) -> Entries:
        """Return the packets of the newest entries of the log, oldest first."""
        return _log_packets(self._log.newest(entries))

    def handlers(self) -> dict[str, Handler]:
        """Return what takes this service's telecommands."""
        return {
            "ENABLE_EVENT": partial(self._switch, enabled=True),
            "DISABLE_EVENT": partial(self._switch, enabled=False),
            "REPORT_DISABLED_EVENTS": lambda _: self._tell_disabled,
            "EVENT_LOG_DUMP": self._dump,
        }

    def _dump(self, request: Request) -> Action:
        return self._dumps.action(request, partial(self.dump, request.whole("entries")))

    def _switch(self, request: Request, *, enabled: bool) -> Action:
        number = request.whole("event")
        if number == 0:
            raise TcError(Error.BAD_ARG, 1, 0)

        def act() -> Done:
            self._tracks.setdefault(number, _Track()).enabled = enabled
            return Done.NOW

        return act

    def _tell_disabled(self) -> Done:
        disabled = self.disabled
        for start in range(0, max(len(disabled), 1), DISABLED_SLOTS):
            part = disabled[start : start + DISABLED_SLOTS]
            part += [0] * (DISABLED_SLOTS - len(part))
            slots = {f"event_{k}": number for k, number in enumerate(part, start=1)}
            self._send("disabled_events", {"total": len(disabled)} | slots)
        return Done.NOW


def _log_packets(events: list[Event]) -> Iterator[tuple[str, Mapping[str, object]]]:
    if not events:
        nothing = {"time_s": 0.0, "severity": 1, "event": 0, "text": ""}
        yield "event_log_entry", nothing | {"entry": 0, "entries": 0}
    for place, event in enumerate(events, start=1):
        number, text = _identify(event)
        yield (
            "event_log_entry",
            {
                "entry": place,
                "entries": len(events),
                "time_s": event.t_ns * 1e-9,
                "severity": int(Severity[event.severity.upper()]),
                "event": number,
                "text": text,
            },
        )


def _identify(event: Event) -> tuple[int, str]:
    number = IDS.get(event.code, OTHER_ID)
    return number, event.text if number != OTHER_ID else f"{event.code}: {event.text}"
