"""Service 5: logs events, and reports them with a throttle and a switch for each event."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from fsw.errors import WRONG_CONTENT
from fsw.messages import Event
from fsw.telemetry.dictionary import Severity
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.dictionary.events import IDS, OTHER_ID, SECURITY_CODES
from fsw.telemetry.dictionary.reports import DISABLED_SLOTS
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler, each
from fsw.telemetry.services.long_work import Pieces
from fsw.telemetry.state.fair_log import FairLog
from fsw.telemetry.state.journal import Journal

LOG_ENTRIES = 1000
VERIFIED = ("TC_ACCEPTED", "TC_COMPLETED")  # sent as verification reports, not as events
SECURITY_NAME = "security.jsonl"
SECURITY_BYTES = 1 << 20
Logged = tuple[int, Event]  # number of the daemon's start, event


@dataclass(slots=True)
class _Track:
    """Counters and switch of one event."""

    count: int = 0
    since_ns: int = 0  # start of the throttle's present period
    sent: int = 0  # reports in this period
    suppressed: int = 0  # events not reported since the last report
    enabled: bool = True


class Eventing:
    """Logs every event, and reports the enabled events at a limited rate."""

    def __init__(self, context: TelemetryContext) -> None:
        self._context = context
        self._tracks: dict[int, _Track] = {}
        self._boot_count = context.boot.count
        self._log: FairLog[Logged] = FairLog(LOG_ENTRIES)
        self._security: FairLog[Logged] = FairLog(LOG_ENTRIES)
        self._journal = Journal(
            context.state / SECURITY_NAME, SECURITY_BYTES, context.reserve_bytes // 2
        )
        for boot, event in _kept(self._journal.read()):
            self._security.add(event.code, (boot, event))
        self.total = 0
        self.suppressed = 0

    @property
    def disabled(self) -> list[int]:
        """Return the numbers of the events that are not reported."""
        return sorted(number for number, track in self._tracks.items() if not track.enabled)

    def record(self, event: Event) -> None:
        """Log an event; report it if it is enabled and within its throttle."""
        self._log.add(event.code, (self._boot_count, event))
        if event.code in SECURITY_CODES:
            self._security.add(event.code, (self._boot_count, event))
            self._journal.append({"boot_count": self._boot_count} | asdict(event))
        if event.code in VERIFIED:
            return
        self.total += 1
        number, text = _identify(event)
        track = self._tracks.setdefault(number, _Track())
        track.count += 1
        limit = int(self._context.parameter("event_throttle_count"))
        period_s = self._context.parameter("event_throttle_period_s")
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
        self._context.down.send(f"event_{event.severity}", values, event.t_ns)

    def reset_counters(self) -> None:
        """Set the counts of all events to zero; the logs stay."""
        self.total = self.suppressed = 0
        for track in self._tracks.values():
            track.count = 0

    def files(self) -> tuple[Path, Path]:
        """Return the paths of the files of the security log."""
        return self._journal.files

    def values(self) -> dict[str, int]:
        """Return the fields of housekeeping set 1 that count events."""
        return {"events": self.total, "events_suppressed": self.suppressed}

    def dump(self, log: FairLog[Logged], entries: int) -> Pieces:
        """Return the packets of the newest entries of a log, oldest first."""
        return _log_packets(log.newest(entries))

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of this service's telecommands."""
        return {
            "ENABLE_EVENT": each(partial(self._switch, enabled=True)),
            "DISABLE_EVENT": each(partial(self._switch, enabled=False)),
            "REPORT_DISABLED_EVENTS": lambda _: self._report_disabled,
            "EVENT_LOG_DUMP": partial(self._dump, self._log),
            "SECURITY_LOG_DUMP": partial(self._dump, self._security),
        }

    def _dump(self, log: FairLog[Logged], request: Request) -> Action:
        return self._context.long_work.action(
            request, partial(self.dump, log, request.whole("entries"))
        )

    def _switch(self, request: Request, *, enabled: bool) -> Action:
        number = request.whole("event")
        if number == 0:
            raise TcError(Error.BAD_ARG, 1, 0)

        def act() -> Done:
            self._tracks.setdefault(number, _Track()).enabled = enabled
            return Done.NOW

        return act

    def _report_disabled(self) -> Done:
        disabled = self.disabled
        for start in range(0, max(len(disabled), 1), DISABLED_SLOTS):
            part = disabled[start : start + DISABLED_SLOTS]
            count = len(part)
            part += [0] * (DISABLED_SLOTS - len(part))
            slots = {f"event_{k}": number for k, number in enumerate(part, start=1)}
            self._context.down.send("disabled_events", {"n": count} | slots)
        return Done.NOW


def _kept(lines: list[dict[str, Any]]) -> Iterator[Logged]:
    """Yield the security events in the lines of earlier runs; leave out damaged lines."""
    for line in lines[-LOG_ENTRIES:]:
        try:
            event = Event(
                int(line["t_ns"]), str(line["severity"]), str(line["code"]), str(line["text"])
            )
            boot_count = int(line["boot_count"])
            _log_values(boot_count, event)
            yield boot_count, event
        except WRONG_CONTENT:
            continue


def _log_packets(events: list[Logged]) -> Iterator[tuple[str, Mapping[str, object]]]:
    if not events:
        nothing = {"time_s": 0.0, "severity": 1, "event": 0, "boot_count": 0, "text": ""}
        yield "event_log_entry", nothing | {"entry": 0, "entries": 0}
    for place, (boot_count, event) in enumerate(events, start=1):
        yield (
            "event_log_entry",
            _log_values(boot_count, event) | {"entry": place, "entries": len(events)},
        )


def _log_values(boot_count: int, event: Event) -> dict[str, object]:
    number, text = _identify(event)
    return {
        "time_s": event.t_ns * 1e-9,
        "severity": int(Severity[event.severity.upper()]),
        "event": number,
        "boot_count": boot_count,
        "text": text,
    }


def _identify(event: Event) -> tuple[int, str]:
    number = IDS.get(event.code, OTHER_ID)
    return number, event.text if number != OTHER_ID else f"{event.code}: {event.text}"
