"""Service 19: telecommands that events release.

An event queues its action, and `poll` releases the action later. So an event that an action causes
never releases the next action directly. A loop of events and actions ends: a definition that would
act more than `MOST_RELEASES` times within `WINDOW_NS` (a restart: within a day), or more than
`MOST_A_DAY` times within a day, is disabled. Releases are stored before they act, because a restart
would lose them; a restart whose release cannot be stored is not released. An event of sequences
starts no sequence, as no sequence starts one.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import APID_ESTIMATOR, Error
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler
from fsw.telemetry.services.kept_requests import checked_request, packet_of
from fsw.telemetry.services.long_work import Pieces
from fsw.telemetry.state.documents import keep_document, read_document
from fsw.telemetry.state.store import GenerationStore

FOLDER = "event_actions"
OWN_SERVICE = 19
CAPACITY = 32
MOST_QUEUED = 32
RELEASED_PER_POLL = 4
MOST_RELEASES = 10  # of one definition within `WINDOW_NS`
WINDOW_NS = 60_000_000_000
MOST_A_DAY = 100
DAY_NS = 86_400_000_000_000
SEQUENCE_SERVICE = 21
OF_SEQUENCES = "SEQUENCE_"  # begins the codes of their events
ENDS_THE_PROCESS = "RESTART"
NAMES = {event.id: event.code for event in DICTIONARY.events}


@dataclass(slots=True)
class Releases:
    """The last releases of one definition, by the time of day, which a restart does not change."""

    times_ns: deque[int] = field(default_factory=lambda: deque(maxlen=MOST_RELEASES))
    day_began_ns: int = 0
    in_day: int = 0

    def excess(self, now_ns: int, window_ns: int) -> str:
        """Return the limit that another release would exceed; empty: none."""
        times_ns = self.times_ns
        if len(times_ns) == MOST_RELEASES and abs(now_ns - times_ns[0]) < window_ns:
            return f"{MOST_RELEASES} actions within {window_ns / 1e9:.0f} s"
        if self.in_day >= MOST_A_DAY and abs(now_ns - self.day_began_ns) < DAY_NS:
            return f"{MOST_A_DAY} actions within a day"
        return ""

    def note(self, now_ns: int) -> None:
        """Count a release."""
        self.times_ns.append(now_ns)
        if self.in_day == 0 or abs(now_ns - self.day_began_ns) >= DAY_NS:
            self.day_began_ns, self.in_day = now_ns, 0
        self.in_day += 1

    def document(self) -> list[int]:
        """Return plain values, to be stored."""
        return [self.day_began_ns, self.in_day, *self.times_ns]

    @classmethod
    def parse(cls, values: list[int]) -> Releases:
        """Return the releases of plain values. Raises IndexError, TypeError or ValueError."""
        began_ns, in_day, *times_ns = map(int, values)
        return cls(deque(times_ns, MOST_RELEASES), began_ns, in_day)


@dataclass(slots=True)
class Definition:
    """The action of one event: a telecommand, its switch and its releases."""

    packet: bytes
    enabled: bool = False
    released: int = 0  # since the start of the daemon
    releases: Releases = field(default_factory=Releases)


class EventActions:
    """Keeps the actions of events and releases them."""

    def __init__(self, context: TelemetryContext) -> None:
        self._context = context
        self._store = GenerationStore(context.state / FOLDER)
        self._definitions: dict[int, Definition] = {}
        self._queue: deque[int] = deque()
        self.enabled = True
        self._recall()

    def event(self, number: int) -> None:
        """Queue the action of a reported event; disable a definition that acts too often."""
        definition = self._definitions.get(number)
        if not self.enabled or definition is None or not definition.enabled:
            return
        now_ns = self._context.now_ns() + self._context.epoch().utc_less_met_ns
        window_ns = DAY_NS if self._restarts(definition) else WINDOW_NS
        excess = definition.releases.excess(now_ns, window_ns)
        if excess:
            self._limit(number, definition, excess)
        elif len(self._queue) >= MOST_QUEUED:
            self._context.report("EVENT_ACTION_LOST", f"{NAMES[number]}: {MOST_QUEUED} wait")
        else:
            definition.releases.note(now_ns)
            self._queue.append(number)

    def poll(self) -> None:
        """Release the queued actions, at most `RELEASED_PER_POLL` per call."""
        for _ in range(min(RELEASED_PER_POLL, len(self._queue))):
            number = self._queue.popleft()
            definition = self._definitions.get(number)
            if definition is None:
                continue  # deleted in the meantime
            if not self._stored(number, definition):
                continue
            definition.released += 1
            self._context.report("EVENT_ACTION", NAMES[number])
            self._context.executor.receive(definition.packet, f"event {NAMES[number]}")

    def _stored(self, number: int, definition: Definition) -> bool:
        """Store the releases; return whether the action may act."""
        try:
            keep_document(self._store, self._document(self._definitions, enabled=self.enabled))
        except TcError as error:
            if self._restarts(definition):
                text = f"{NAMES[number]}: a restart that is not counted may never end: {error}"
                self._context.report("EVENT_ACTION_LOST", text)
                return False
        return True

    def _restarts(self, definition: Definition) -> bool:
        name = self._context.executor.check(definition.packet).telecommand.name
        return name == ENDS_THE_PROCESS

    def digest(self) -> list[object]:
        """Return all state that telecommands can change, as plain values."""
        return [self._document(self._definitions, enabled=self.enabled)]

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of this service's telecommands."""
        return {
            "ADD_EVENT_ACTION": self._add,
            "DELETE_EVENT_ACTION": self._delete,
            "DELETE_EVENT_ACTIONS": lambda _: self._delete_all,
            "ENABLE_EVENT_ACTION": partial(self._switch, enabled=True),
            "DISABLE_EVENT_ACTION": partial(self._switch, enabled=False),
            "REPORT_EVENT_ACTION_STATUS": partial(
                self._context.long_work.action, make=self._status
            ),
            "ENABLE_EVENT_ACTIONS": lambda _: partial(self._switch_all, enabled=True),
            "DISABLE_EVENT_ACTIONS": lambda _: partial(self._switch_all, enabled=False),
            "REPORT_EVENT_ACTION": self._report_definition,
        }

    def _add(self, request: Request) -> Action:
        number = request.whole("event")
        if number == 0:
            raise TcError(Error.BAD_ARG, 3, 0, "no event")
        checked_request(self._context.executor, request.data, 4, _barred(number))
        before = self._definitions.get(number)
        if before is not None and before.enabled:
            raise TcError(Error.BUSY, 3, number, "its action is enabled")
        if before is None and len(self._definitions) >= CAPACITY:
            raise TcError(Error.BUSY, 3, CAPACITY, "no place for another action")
        return partial(self._change, {number: Definition(request.data)})

    def _delete(self, request: Request) -> Action:
        number, definition = self._find(request)
        if definition.enabled:
            raise TcError(Error.BUSY, 3, number, "its action is enabled")
        return partial(self._change, {number: None})

    def _delete_all(self) -> Done:
        return self._change(dict.fromkeys(self._definitions))

    def _switch(self, request: Request, *, enabled: bool) -> Action:
        number, definition = self._find(request)
        changed = replace(definition, enabled=enabled)
        return partial(self._change, {number: changed})

    def _switch_all(self, *, enabled: bool) -> Done:
        keep_document(self._store, self._document(self._definitions, enabled=enabled))
        self.enabled = enabled
        return Done.NOW

    def _find(self, request: Request) -> tuple[int, Definition]:
        number = request.whole("event")
        definition = self._definitions.get(number)
        if definition is None:
            raise TcError(Error.BAD_ARG, 3, number, "it has no action")
        return number, definition

    def _change(self, changes: dict[int, Definition | None]) -> Done:
        """Store changed definitions, then use them. Raises TcError; then nothing has changed."""
        merged = {**self._definitions, **changes}
        definitions = {number: item for number, item in merged.items() if item is not None}
        keep_document(self._store, self._document(definitions, enabled=self.enabled))
        self._definitions = definitions
        return Done.NOW

    def _limit(self, number: int, definition: Definition, excess: str) -> None:
        """Disable an action that is released too often, and report that."""
        definition.enabled = False
        self._context.report("EVENT_ACTION_LIMITED", f"{NAMES[number]}: {excess}; disabled")
        try:
            keep_document(self._store, self._document(self._definitions, enabled=self.enabled))
        except TcError as error:
            self._context.report("TC_FAILED", f"event actions: {error}")

    @staticmethod
    def _document(definitions: dict[int, Definition], *, enabled: bool) -> dict[str, object]:
        entries = [
            {
                "event": number,
                "enabled": item.enabled,
                "packet": item.packet.hex(),
                "releases": item.releases.document(),
            }
            for number, item in definitions.items()
        ]
        return {"enabled": enabled, "definitions": entries}

    def _recall(self) -> None:
        """Read the definitions of the last run; leave out telecommands that are no longer valid."""
        found, damaged = read_document(self._store, _parse)
        faults = [f"{damaged} generations cannot be read"] if damaged else []
        if found is not None:
            self.enabled, definitions = found
            for number, definition in definitions[:CAPACITY]:
                try:
                    packet = definition.packet
                    checked_request(self._context.executor, packet, 4, _barred(number))
                except TcError as error:
                    faults.append(f"{NAMES.get(number, number)}: {error}")
                else:
                    self._definitions[number] = definition
        if faults:
            text = f"event actions: {'; '.join(faults[:3])}"
            self._context.report("STORED_REQUESTS_CORRUPT", text)

    def _status(self) -> Pieces:
        empty = {"n": 0, "apid": 0, "event": 0, "enabled": False, "released": 0}
        rows = [
            {
                "n": 1,
                "apid": APID_ESTIMATOR,
                "event": number,
                "enabled": definition.enabled,
                "released": definition.released,
            }
            for number, definition in self._definitions.items()
        ]
        for row in rows or [empty]:
            yield "event_action_status", row | {"function_enabled": self.enabled}

    def _report_definition(self, request: Request) -> Action:
        number, definition = self._find(request)

        def act() -> Done:
            values = {"n": 1, "apid": APID_ESTIMATOR, "event": number}
            values |= {"enabled": definition.enabled}
            hexadecimal = definition.packet.hex()
            self._context.down.send("event_action", {**values, "request_hex": hexadecimal})
            return Done.NOW

        return act


def _barred(number: int) -> tuple[int, ...]:
    """Return the services whose telecommands cannot be the action of an event."""
    of_sequences = NAMES.get(number, "").startswith(OF_SEQUENCES)
    return (OWN_SERVICE, SEQUENCE_SERVICE) if of_sequences else (OWN_SERVICE,)


def _parse(document: Any) -> tuple[bool, list[tuple[int, Definition]]]:  # noqa: ANN401
    """Return the switch of the service, and each event's number with its action."""
    found = []
    for entry in document["definitions"]:
        number = entry["event"]
        if number not in NAMES:
            raise ValueError(f"event {number} is not in the dictionary")
        releases = Releases.parse(entry.get("releases", [0, 0]))
        definition = Definition(
            packet_of(entry["packet"]), bool(entry["enabled"]), releases=releases
        )
        found.append((number, definition))
    return bool(document["enabled"]), found
