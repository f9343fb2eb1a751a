"""Long answers and long work on files, done in pieces so that no other work has to wait."""

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from functools import partial

from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.downlink import Downlink
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.executor import Action, Done, TelecommandExecutor

PIECES_PER_POLL = 32  # of all running work together

Packet = tuple[str, Mapping[str, object]]  # name, values
Pieces = Iterable[Packet | None]  # a packet to send, or None: a piece that sends no packet


class LongWork:
    """Does the work of long telecommands, at most `PIECES_PER_POLL` pieces in one poll.

    Only one telecommand of a name runs at a time; another one is rejected as BUSY.
    """

    def __init__(self, down: Downlink, executor: TelecommandExecutor) -> None:
        self._down, self._executor = down, executor
        self._running: dict[str, tuple[Request, Iterator[Packet | None]]] = {}
        self._left = PIECES_PER_POLL

    def action(self, request: Request, make: Callable[[], Pieces]) -> Action:
        """Return the action that begins the work.

        Parameters
        ----------
        make : returns the pieces; `make` and the pieces may raise TcError or OSError, and the
            telecommand then fails

        Raises
        ------
        TcError BUSY while a telecommand of this name runs.
        """
        if request.telecommand.name in self._running:
            raise TcError(Error.BUSY, text="one is under way")
        return partial(self._begin, request, make)

    def poll(self) -> None:
        """Do the next pieces, one of each running work in turn."""
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
                self._running[name] = request, pieces  # at the end, to be the last in turn

    def close(self) -> None:
        """End all running work; work on files leaves no partial results."""
        for _, pieces in self._running.values():
            if isinstance(pieces, Generator):
                pieces.close()
        self._running.clear()

    def _begin(self, request: Request, make: Callable[[], Pieces]) -> Done:
        """Do the pieces that this poll has left; return LATER if work remains. Raises TcError."""
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
        """Do one piece; return True if no piece was left."""
        try:
            packet = next(pieces)
        except StopIteration:
            return True
        self._left -= 1
        if packet is not None:
            self._down.send(*packet)
        return False


def _reason(error: Exception) -> TcError:
    """Return the TcError for an error of a telecommand; a system error keeps its text."""
    if isinstance(error, OSError):
        return TcError(Error.FAILED, text=f"{error.filename or 'file'}: {error.strerror or error}")
    return TcError.of(error)
