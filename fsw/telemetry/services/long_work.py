"""Long answers and long work on files: piece by piece, so that nothing else has to wait."""

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from functools import partial

from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.downlink import Downlink
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.executor import Action, Done, TelecommandExecutor

PIECES_PER_POLL = 32  # of everything under way together

Packet = tuple[str, Mapping[str, object]]  # name, values
Pieces = Iterable[Packet | None]  # a packet to send, or None: work that sends nothing


class LongWork:
    """Does the work of telecommands that take long, at most so many pieces in one poll.

    One of a kind is under way at a time: further requests for it are BUSY.
    """

    def __init__(self, down: Downlink, executor: TelecommandExecutor) -> None:
        self._down, self._executor = down, executor
        self._running: dict[str, tuple[Request, Iterator[Packet | None]]] = {}
        self._left = PIECES_PER_POLL

    def action(self, request: Request, make: Callable[[], Pieces]) -> Action:
        """Return the action that begins the work. Raises TcError BUSY while one of its kind runs.

        Parameters
        ----------
        make : returns the pieces; it and they may raise TcError or OSError, which ends the
            telecommand as failed
        """
        if request.telecommand.name in self._running:
            raise TcError(Error.BUSY, text="one is under way")
        return partial(self._begin, request, make)

    def poll(self) -> None:
        """Do the next pieces, one of everything under way in turn."""
        self._left = PIECES_PER_POLL
        while self._left > 0 and self._running:
            name = next(iter(self._running))
            request, pieces = self._running.pop(name)
            try:
                is_over, error = self._is_over(pieces), None
            except Exception as failure:  # noqa: BLE001 - no telecommand ends the service
                is_over, error = True, _reason(failure)
            if is_over:
                self._executor.finish(request, error)
            else:
                self._running[name] = request, pieces  # at the end: its turn comes last

    def close(self) -> None:
        """End what is under way; work on files leaves nothing half made."""
        for _, pieces in self._running.values():
            if isinstance(pieces, Generator):
                pieces.close()
        self._running.clear()

    def _begin(self, request: Request, make: Callable[[], Pieces]) -> Done:
        """Do as many pieces as this poll has left. Raises TcError."""
        try:
            pieces = iter(make())
            while self._left > 0:
                if self._is_over(pieces):
                    return Done.NOW
        except OSError as error:
            raise _reason(error) from error
        self._running[request.telecommand.name] = request, pieces
        return Done.LATER

    def _is_over(self, pieces: Iterator[Packet | None]) -> bool:
        """Do one piece; return whether there was none."""
        try:
            packet = next(pieces)
        except StopIteration:
            return True
        self._left -= 1
        if packet is not None:
            self._down.send(*packet)
        return False


def _reason(error: Exception) -> TcError:
    """Return why a telecommand failed; the system's own words of a system error."""
    if isinstance(error, OSError):
        return TcError(Error.FAILED, text=f"{error.filename or 'file'}: {error.strerror or error}")
    return TcError.of(error)
