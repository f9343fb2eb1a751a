"""Telecommands that begin, report, suspend, resume and cancel file transfers."""

from collections.abc import Mapping
from functools import partial

from file_delivery.errors import DeliveryError
from file_delivery.transfer import Key
from fsw.telemetry.dictionary.codes import TRANSFER_STATE, Error
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.ports import FileDelivery
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler
from fsw.telemetry.services.filing import Filing
from fsw.telemetry.services.long_work import Pieces

FILE_COUNTERS = ("files_sent", "files_received", "files_failed", "pdus_sent", "pdus_received")


class Transfers:
    """Handles the telecommands of file transfer; `delivery` implements the protocol."""

    def __init__(self, context: TelemetryContext, filing: Filing, delivery: FileDelivery) -> None:
        self._context, self._filing, self.delivery = context, filing, delivery
        self._sending: dict[int, Request] = {}

    def poll(self, now_ns: int, *, sending: bool) -> None:
        """Report the transfers that ended; send the next units down if `sending` is true."""
        for number, success, text in self.delivery.finished():
            request = self._sending.pop(number, None)
            good = "FILE_RECEIVED" if request is None else "FILE_SENT"
            self._context.report(good if success else "FILE_FAILED", text)
            if request is not None:
                error = None if success else TcError(Error.TIMEOUT, text=text)
                self._context.executor.finish(request, error)
        if sending:
            for unit in self.delivery.poll(now_ns):
                self._context.down.file_unit(unit)

    def values(self) -> Mapping[str, int]:
        """Return the fields of housekeeping set 8 that count files and units."""
        counters = self.delivery.counters()
        return {name: counters.get(name, 0) for name in FILE_COUNTERS}

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of these telecommands."""
        return {
            "DOWNLINK_FILE": self._downlink,
            "DOWNLINK_PIECE": self._downlink_piece,
            "REPORT_TRANSFERS": partial(self._context.long_work.action, make=self._list),
            "SUSPEND_TRANSFER": self._suspend,
            "RESUME_TRANSFER": self._resume,
            "ABORT_TRANSFER": self._abort,
        }

    def _downlink(self, request: Request) -> Action:
        remove = bool(request.whole("remove"))
        if remove:
            self._filing.writable(request.text("path"))
        return self._begin(request, "", None, remove=remove)

    def _downlink_piece(self, request: Request) -> Action:
        piece = (request.whole("offset"), request.whole("size_bytes"))
        return self._begin(request, request.text("name"), piece, remove=False)

    def _begin(
        self, request: Request, name: str, piece: tuple[int, int] | None, *, remove: bool
    ) -> Action:
        # a file that is being written would grow during the transfer, and its checksum would change
        path = self._filing.free(self._filing.existing(request.text("path")))
        size = path.stat().st_size
        if piece is not None and sum(piece) > size:
            raise TcError(Error.OUT_OF_RANGE, 3, size, text=f"the file has {size} bytes")

        def act() -> Done:
            try:
                number = self.delivery.send(path, remove=remove, name=name, piece=piece)
            except DeliveryError as error:
                raise _failure(error) from error
            except OSError as error:
                raise TcError(Error.FAILED, text=error.strerror or str(error)) from error
            self._sending[number] = request
            return Done.LATER

        return act

    def _list(self) -> Pieces:
        found = self.delivery.transfers()
        for entry, item in enumerate(found, start=1):
            values = {
                "entry": entry,
                "entries": len(found),
                "source": item.key[0],
                "number": item.key[1],
                "path": item.name,
                "size_bytes": item.size,
                "done_bytes": item.done,
                "state": TRANSFER_STATE.value(item.state.value),
            }
            yield "transfer_status", values
        if not found:
            names = ("entry", "entries", "source", "number", "size_bytes", "done_bytes")
            none = dict.fromkeys((*names, "state"), 0)
            yield "transfer_status", none | {"path": ""}

    def _suspend(self, request: Request) -> Action:
        return partial(_done, partial(self.delivery.suspend, _key(request)))

    def _resume(self, request: Request) -> Action:
        return partial(_done, partial(self.delivery.resume, _key(request), self._context.now_ns()))

    def _abort(self, request: Request) -> Action:
        return partial(_done, partial(self.delivery.cancel, _key(request)))


def _key(request: Request) -> Key:
    return request.whole("source"), request.whole("number")


def _done(act: partial[None]) -> Done:
    try:
        act()
    except DeliveryError as error:
        raise _failure(error) from error
    return Done.NOW


def _failure(error: DeliveryError) -> TcError:
    known = error.code in Error.__members__
    return TcError(Error[error.code] if known else Error.FAILED, text=str(error))
