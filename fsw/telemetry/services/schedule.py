"""Service 11: telecommands that wait for their time. A restart forgets them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import from_cuc
from fsw.telemetry.link.telecommands import Request, RequestId, TcError
from fsw.telemetry.services.executor import Action, Done, Handler, Report, Send

CAPACITY = 64
OWN_SERVICE = 11


@dataclass(frozen=True, slots=True)
class _Activity:
    release_ns: int
    request: Request
    packet: bytes


class Schedule:
    """Keeps time-tagged telecommands in order and releases them.

    Parameters
    ----------
    check : reads a telecommand without doing it; raises TcError
    release : does it
    margin_s : least time ahead
    """

    def __init__(
        self,
        check: Callable[[bytes], Request],
        release: Callable[[bytes], bool],
        margin_s: Callable[[], float],
        now_ns: Callable[[], int],
        send: Send,
        report: Report,
    ) -> None:
        self._check, self._release, self._margin_s = check, release, margin_s
        self._now_ns, self._send, self._report = now_ns, send, report
        self._waiting: list[_Activity] = []
        self.enabled = True
        self.released = 0
        self.discarded = 0

    @property
    def entries(self) -> int:
        """Telecommands that wait."""
        return len(self._waiting)

    def poll(self, now_ns: int) -> None:
        """Release what is due; discard it while the schedule is disabled."""
        while self._waiting and self._waiting[0].release_ns <= now_ns:
            activity = self._waiting.pop(0)
            name = activity.request.telecommand.name
            if not self.enabled:
                self._discard(activity)
                continue
            self.released += 1
            self._report("SCHEDULE_RELEASED", name)
            self._release(activity.packet)

    def handlers(self) -> dict[str, Handler]:
        """Return what takes this service's telecommands."""
        return {
            "ENABLE_SCHEDULE": lambda _: partial(self._switch, enabled=True),
            "DISABLE_SCHEDULE": lambda _: partial(self._switch, enabled=False),
            "RESET_SCHEDULE": lambda _: self._reset,
            "INSERT_ACTIVITY": self._insert,
            "DELETE_ACTIVITY": self._delete,
            "REPORT_SCHEDULE": lambda _: self._tell,
        }

    def _switch(self, *, enabled: bool) -> Done:
        self.enabled = enabled
        return Done.NOW

    def _reset(self) -> Done:
        for activity in self._waiting:
            self._discard(activity)
        self._waiting = []
        return Done.NOW

    def _insert(self, request: Request) -> Action:
        fine = request.whole("release_fine")
        time = struct.pack(
            ">BIBH",
            request.whole("release_p_field"),
            request.whole("release_coarse_s"),
            fine >> 16,
            fine & 0xFFFF,
        )
        release_ns = from_cuc(time)
        inner = self._check(request.data)
        if inner.telecommand.service == OWN_SERVICE:
            raise TcError(Error.BAD_ARG, 4, text="the schedule does not command itself")
        if release_ns < self._now_ns() + round(self._margin_s() * 1e9):
            raise TcError(Error.OUT_OF_RANGE, 2, release_ns * 1e-9, "not ahead")
        if len(self._waiting) >= CAPACITY:
            raise TcError(Error.BUSY, value=CAPACITY, text="the schedule is full")
        if any(activity.request.id == inner.id for activity in self._waiting):
            raise TcError(Error.BAD_ARG, 4, text="one of the same request id waits")
        return partial(self._keep, _Activity(release_ns, inner, request.data))

    def _keep(self, activity: _Activity) -> Done:
        self._waiting.append(activity)
        self._waiting.sort(key=lambda item: item.release_ns)
        return Done.NOW

    def _delete(self, request: Request) -> Action:
        wanted = RequestId(
            packet_id=request.whole("request_packet_id"),
            sequence=request.whole("request_sequence"),
        )
        found = [activity for activity in self._waiting if activity.request.id == wanted]
        if not found:
            raise TcError(Error.BAD_ARG, 2, wanted.sequence, "none like this waits")

        def act() -> Done:
            self._waiting.remove(found[0])
            self._discard(found[0])
            return Done.NOW

        return act

    def _discard(self, activity: _Activity) -> None:
        self.discarded += 1
        self._report("SCHEDULE_DISCARDED", activity.request.telecommand.name)

    def _tell(self) -> Done:
        if not self._waiting:
            empty = {"release_time_s": 0.0, "request_packet_id": 0, "request_sequence": 0}
            empty |= {"entry": 0, "entries": 0, "service": 0, "subtype": 0}
            self._send("schedule_entry", empty)
        for place, activity in enumerate(self._waiting, start=1):
            request = activity.request
            values = {
                "entry": place,
                "entries": len(self._waiting),
                "release_time_s": activity.release_ns / 1e9,  # a whole second stays one
                "request_packet_id": request.id.packet_id,
                "request_sequence": request.id.sequence,
                "service": request.telecommand.service,
                "subtype": request.telecommand.subtype,
            }
            self._send("schedule_entry", values)
        return Done.NOW
