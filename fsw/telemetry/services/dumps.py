"""Long answers: a log or a list goes down piece by piece, so that nothing else has to wait."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial

from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.downlink import Downlink
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.executor import Action, Done, TelecommandExecutor

PACKETS_PER_POLL = 32  # of all dumps together

Entries = Iterable[tuple[str, Mapping[str, object]]]  # packet name, values


class Dumps:
    """Sends the packets of long answers, at most so many in one poll.

    One dump of a kind is under way at a time: further requests for it are BUSY.
    """

    def __init__(self, down: Downlink, executor: TelecommandExecutor) -> None:
        self._down, self._executor = down, executor
        self._running: dict[str, tuple[Request, Iterator[tuple[str, Mapping[str, object]]]]] = {}
        self._left = PACKETS_PER_POLL

    def action(self, request: Request, make: Callable[[], Entries]) -> Action:
        """Return what begins a dump. Raises TcError BUSY while one of its kind is under way."""
        if request.telecommand.name in self._running:
            raise TcError(Error.BUSY, text="one is under way")
        return partial(self._begin, request, make)

    def poll(self) -> None:
        """Send the next pieces, of every dump in turn."""
        self._left = PACKETS_PER_POLL
        for name in list(self._running):
            request, entries = self._running.pop(name)
            if not self._advance(entries):
                self._running[name] = request, entries
            else:
                self._executor.finish(request)

    def _begin(self, request: Request, make: Callable[[], Entries]) -> Done:
        entries = iter(make())
        if self._advance(entries):
            return Done.NOW
        self._running[request.telecommand.name] = request, entries
        return Done.LATER

    def _advance(self, entries: Iterator[tuple[str, Mapping[str, object]]]) -> bool:
        """Send as many packets as this poll has left; whether that was all."""
        while self._left > 0:
            packet = next(entries, None)
            if packet is None:
                return True
            self._down.send(*packet)
            self._left -= 1
        return False
