"""Service 9: time packets, every power of two of seconds."""

from __future__ import annotations

from collections.abc import Callable

from fsw.telemetry.link.telecommands import Request
from fsw.telemetry.services.executor import Action, Done, Handler

SECOND_NS = 1_000_000_000


class TimeReports:
    """Sends time packets when they are due.

    Parameters
    ----------
    send : sends one, which tells the exponent of their interval
    configured : exponent as long as none was commanded in this run
    """

    def __init__(self, send: Callable[[int], None], configured: Callable[[], int]) -> None:
        self._send, self._configured = send, configured
        self._due_ns = 0
        self._commanded: int | None = None

    @property
    def exponent(self) -> int:
        """Return the exponent in force."""
        return self._configured() if self._commanded is None else self._commanded

    def poll(self, now_ns: int) -> None:
        """Send one if its time has come."""
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + (SECOND_NS << self.exponent)
            self._send(self.exponent)

    def handlers(self) -> dict[str, Handler]:
        """Return what takes this service's telecommand."""
        return {"SET_TIME_REPORT_RATE": self._set}

    def _set(self, request: Request) -> Action:
        def act() -> Done:
            self._commanded, self._due_ns = request.whole("exponent"), 0
            return Done.NOW

        return act
