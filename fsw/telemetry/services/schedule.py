"""Service 11: telecommands that are released at a given time, even after a restart.

A change of the schedule is stored on the disk before it has an effect. A release is stored before
it happens, in place, so that neither a crash nor a full disk releases a telecommand twice; if the
disk cannot be written at all, it is still released. Times are stored with their epoch, to convert
them after a restart.
"""

import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from file_delivery.slots import SlotFile
from fsw.errors import WRONG_CONTENT
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import FRACTIONS_PER_S, from_cuc
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler, for_each
from fsw.telemetry.services.kept_requests import (
    checked_request,
    is_request,
    packet_of,
    source_of,
)
from fsw.telemetry.services.long_work import Pieces
from fsw.telemetry.state.documents import keep_document, read_document
from fsw.telemetry.state.epoch import Epoch, carried_over
from fsw.telemetry.state.store import GenerationStore

FOLDER = "schedule"
RELEASED = "schedule_released"  # file with the time of the newest release
CAPACITY = 64
OWN_SERVICE = 11
APID_MASK, COUNT_MASK = 0x7FF, 0x3FFF
LATE_NS = 5_000_000_000  # after a restart, later telecommands are discarded
LATEST_NS = (1 << 32) * 1_000_000_000  # end of the range of a CUC with 4 bytes of seconds


@dataclass(frozen=True, slots=True)
class Activity:
    """One telecommand; `release_ns` is mission elapsed time [ns]."""

    release_ns: int
    request: Request
    packet: bytes


class Schedule:
    """Keeps time-tagged telecommands in order and releases them."""

    def __init__(self, context: TelemetryContext) -> None:
        self._context = context
        self._store = GenerationStore(context.state / FOLDER)
        self._released_through = SlotFile(context.state / RELEASED)
        self._waiting: list[Activity] = []
        self.enabled = True
        self.released = 0
        self.discarded = 0
        self._recall()

    @property
    def entries(self) -> int:
        """Return the number of waiting telecommands."""
        return len(self._waiting)

    def poll(self, now_ns: int) -> None:
        """Release the telecommands that are due; discard them while the schedule is disabled."""
        due = [activity for activity in self._waiting if activity.release_ns <= now_ns]
        if not due:
            return
        self._waiting = self._waiting[len(due) :]
        try:
            self._keep_release(due[-1].release_ns)
            self._keep(self._waiting, enabled=self.enabled)
        except (OSError, TcError) as error:
            self._context.report("TC_FAILED", f"schedule: {error}")
        for activity in due:
            if not self.enabled:
                self._discard(activity, "the schedule is disabled")
                continue
            self.released += 1
            self._context.report("SCHEDULE_RELEASED", activity.request.telecommand.name)
            self._context.executor.receive(activity.packet, "schedule")

    def values(self) -> dict[str, object]:
        """Return the schedule's fields of housekeeping set 8."""
        return {
            "schedule_enabled": self.enabled,
            "schedule_entries": self.entries,
            "schedule_released": self.released,
            "schedule_discarded": self.discarded,
        }

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of this service's telecommands."""
        return {
            "ENABLE_SCHEDULE": lambda _: partial(self._switch, enabled=True),
            "DISABLE_SCHEDULE": lambda _: partial(self._switch, enabled=False),
            "RESET_SCHEDULE": lambda _: self._reset,
            "INSERT_ACTIVITY": self._insert,
            "DELETE_ACTIVITY": self._delete,
            "SHIFT_ACTIVITY": self._shift_one,
            "SHIFT_SCHEDULE": self._shift_all,
            "REPORT_SCHEDULE": partial(self._context.long_work.action, make=self._summary),
            "REPORT_SCHEDULE_DETAIL": partial(self._context.long_work.action, make=self._detail),
        }

    def _switch(self, *, enabled: bool) -> Done:
        self._keep(self._waiting, enabled=enabled)
        self.enabled = enabled
        return Done.NOW

    def _reset(self) -> Done:
        before = self._waiting
        self._change([])
        for activity in before:
            self._discard(activity, "reset")
        return Done.NOW

    def _insert(self, request: Request) -> Action:
        new: list[Activity] = []
        for_each(request, lambda element: new.append(self._activity(element, new)))
        return partial(self._change_done, lambda: [*self._waiting, *new])

    def _activity(self, request: Request, before: list[Activity]) -> Activity:
        """Return the activity in one element; `before`: activities of the elements before."""
        release_ns = _release_ns(request)
        inner = checked_request(self._context.executor, request.data, 4, (OWN_SERVICE,))
        if release_ns < self._earliest_ns():
            raise TcError(Error.OUT_OF_RANGE, 2, release_ns * 1e-9, "not ahead")
        present = [*self._waiting, *before]
        if len(present) >= CAPACITY:
            raise TcError(Error.BUSY, value=CAPACITY, text="the schedule is full")
        if any(activity.request.id == inner.id for activity in present):
            raise TcError(Error.BAD_ARG, 4, text="one of the same request id waits")
        return Activity(release_ns, inner, request.data)

    def _delete(self, request: Request) -> Action:
        found = [activity for named in for_each(request, self._named) for activity in named]

        def act() -> Done:
            self._change([activity for activity in self._waiting if activity not in found])
            for activity in found:
                self._discard(activity, "deleted")
            return Done.NOW

        return act

    def _named(self, request: Request) -> list[Activity]:
        """Return the waiting activities that a request identifier names. Raises TcError."""
        source, apid = request.whole("source_id"), request.whole("apid")
        count = request.whole("sequence_count")
        found = [a for a in self._waiting if is_request(source, apid, count, a.packet)]
        if not found:
            raise TcError(Error.BAD_ARG, 3, count, "none like this waits")
        return found

    def _shift_one(self, request: Request) -> Action:
        try:
            found = self._named(request)
        except TcError as error:
            error.argument = 6
            raise
        return self._shift(request, found)

    def _shift_all(self, request: Request) -> Action:
        return self._shift(request, list(self._waiting))

    def _shift(self, request: Request, chosen: list[Activity]) -> Action:
        """Return the action that shifts all chosen activities. Raises TcError OUT_OF_RANGE."""
        offset_ns = _offset_ns(request)
        moved = {id(a): replace(a, release_ns=a.release_ns + offset_ns) for a in chosen}
        for activity in moved.values():
            if not self._earliest_ns() <= activity.release_ns < LATEST_NS:
                text = f"{activity.request.telecommand.name} would not lie ahead"
                raise TcError(Error.OUT_OF_RANGE, 1, offset_ns * 1e-9, text)
        return partial(self._change_done, lambda: [moved.get(id(a), a) for a in self._waiting])

    def _earliest_ns(self) -> int:
        margin_s = self._context.parameter("schedule_margin_s")
        return self._context.now_ns() + round(margin_s * 1e9)

    def _change_done(self, change: Callable[[], list[Activity]]) -> Done:
        self._change(change())
        return Done.NOW

    def _change(self, waiting: list[Activity]) -> None:
        """Store other activities, then use them. Raises TcError; then nothing has changed."""
        ordered = sorted(waiting, key=lambda item: item.release_ns)
        self._keep(ordered, enabled=self.enabled)
        self._waiting = ordered

    def _keep_release(self, release_ns: int) -> None:
        """Store the time up to which activities were released. Raises OSError."""
        clock = self._context.epoch().clock_id
        self._released_through.write({"clock_id": clock, "release_ns": release_ns})

    def _released_ns(self, clock_id: str) -> int:
        """Return the time up to which activities were released in this start of the machine."""
        try:
            stored = self._released_through.read()
            return int(stored["release_ns"]) if stored["clock_id"] == clock_id else -1
        except (OSError, *WRONG_CONTENT) as error:
            text = f"time of the newest release: {error}"
            self._context.report("STORED_REQUESTS_CORRUPT", text)
        return -1

    def _keep(self, waiting: list[Activity], *, enabled: bool) -> None:
        entries = [{"release_ns": a.release_ns, "packet": a.packet.hex()} for a in waiting]
        epoch = self._context.epoch().document()
        keep_document(self._store, {"enabled": enabled, "epoch": epoch, "entries": entries})

    def _recall(self) -> None:
        """Read the activities that waited when the last run ended; discard those too late."""
        found, damaged = read_document(self._store, _parse)
        if damaged:
            text = f"schedule: {damaged} generations cannot be read"
            self._context.report("STORED_REQUESTS_CORRUPT", text)
        if not self._released_through.path.exists():  # made while there is room for it
            with suppress(OSError):  # the first release tries again, and says so
                self._keep_release(-1)
        if found is None:
            return
        self.enabled, then, entries = found
        now, now_ns = self._context.epoch(), self._context.now_ns()
        released_ns = self._released_ns(then.clock_id)
        for release_ns, packet in entries:
            if release_ns <= released_ns:
                continue
            try:
                request = checked_request(self._context.executor, packet, 4, (OWN_SERVICE,))
            except TcError as error:
                self.discarded += 1
                self._context.report("SCHEDULE_DISCARDED", f"kept telecommand: {error}")
                continue
            activity = Activity(carried_over(release_ns, then, now), request, packet)
            if activity.release_ns < now_ns - LATE_NS:
                self._discard(activity, "its time passed while the daemon was down")
            elif len(self._waiting) >= CAPACITY:
                self._discard(activity, f"more than {CAPACITY} were stored")
            else:
                self._waiting.append(activity)
        self._waiting.sort(key=lambda item: item.release_ns)
        if self._waiting:
            self._context.report("SCHEDULE_RESTORED", f"{len(self._waiting)} telecommands wait")

    def _discard(self, activity: Activity, why: str) -> None:
        self.discarded += 1
        text = f"{activity.request.telecommand.name}: {why}"
        self._context.report("SCHEDULE_DISCARDED", text)

    def _summary(self) -> Pieces:
        if not self._waiting:
            empty = {"release_time_s": 0.0, "source_id": 0, "apid": 0, "sequence_count": 0}
            yield "schedule_entry", empty | {"n": 0, "service": 0, "subtype": 0}
        for activity in self._waiting:
            request = activity.request
            values = {
                "n": 1,
                "release_time_s": activity.release_ns / 1e9,  # a whole second stays whole
                "source_id": source_of(activity.packet),
                "apid": request.id.packet_id & APID_MASK,
                "sequence_count": request.id.sequence & COUNT_MASK,
                "service": request.telecommand.service,
                "subtype": request.telecommand.subtype,
            }
            yield "schedule_entry", values

    def _detail(self) -> Pieces:
        if not self._waiting:
            yield "schedule_detail", {"n": 0, "release_time_s": 0.0, "request_hex": ""}
        for activity in self._waiting:
            values = {"n": 1, "release_time_s": activity.release_ns / 1e9}
            yield "schedule_detail", values | {"request_hex": activity.packet.hex()}


def _release_ns(request: Request) -> int:
    """Return the release time in a telecommand [ns, mission elapsed time]."""
    fine = request.whole("release_fine")
    time = struct.pack(
        ">BIBH",
        request.whole("release_p_field"),
        request.whole("release_coarse_s"),
        fine >> 16,
        fine & 0xFFFF,
    )
    return from_cuc(time)


def _offset_ns(request: Request) -> int:
    """Return the offset in a telecommand [ns]: relative CUC of 56 bits, two's complement."""
    fractions = request.whole("offset_coarse_s") * FRACTIONS_PER_S + request.whole("offset_fine")
    return round(fractions * 1_000_000_000 / FRACTIONS_PER_S)


def _parse(document: Any) -> tuple[bool, Epoch, list[tuple[int, bytes]]]:  # noqa: ANN401
    """Return the switch, the epoch of the times, and release times [ns] with packets."""
    entries = []
    for entry in document["entries"]:
        if not isinstance(entry["release_ns"], int):
            raise TypeError("release_ns must be a whole number")
        entries.append((entry["release_ns"], packet_of(entry["packet"])))
    return bool(document["enabled"]), Epoch.parse(document["epoch"]), entries
