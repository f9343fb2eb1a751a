"""Reads the rings of loop and estimation; the estimation's ring before each status of the loop."""

from collections.abc import Callable

from fsw.exchange.ring import RingReader
from fsw.exchange.ringlink import Kind, message_of
from fsw.exchange.sinks import JoinedStatus, Sink, StatusReport

AT_ONCE = 2000  # records read before clients are served again


class Inbox:
    """Reads the rings of loop and estimation.

    Parameters
    ----------
    sink : receives the messages
    report : receives severity, code and text of an event about lost records
    """

    def __init__(
        self,
        loop: RingReader,
        estimation: RingReader,
        sink: Sink,
        report: Callable[[str, str, str], None],
    ) -> None:
        self._loop, self._estimation = loop, estimation
        self._sink, self._report = JoinedStatus(sink), report
        self._told = 0
        self.is_open = True  # until the loop's record of the end

    @property
    def is_idle(self) -> bool:
        """Whether no record waits in the rings."""
        return not (self._loop.used_bytes or self._estimation.used_bytes)

    @property
    def dropped(self) -> int:
        """Number of records lost because a ring was full."""
        return self._loop.dropped + self._estimation.dropped

    def take(self) -> bool:
        """Pass the waiting messages to the sink; return whether more may wait."""
        taken = self._take_found()
        for record in self._loop.read(AT_ONCE):
            taken += 1
            message = message_of(record)
            if record.kind == Kind.END or isinstance(message, StatusReport):
                self._take_found()  # the estimation's earlier messages first
            self.is_open &= record.kind != Kind.END
            if message is not None:
                self._sink.put(message)
        dropped = self.dropped
        if dropped > self._told:
            text = f"{dropped - self._told} records lost on the way to the service"
            self._told = dropped
            self._report("high", "RING_DROPS", text)
        return taken >= AT_ONCE

    def _take_found(self) -> int:
        taken = 0
        for record in self._estimation.read():
            taken += 1
            message = message_of(record)
            if message is not None:
                self._sink.put(message)
        return taken
