"""Executes telecommands: checks, verification reports of service 1, counters.

A handler checks a request and returns the action to execute. It raises `TcError` to reject the
request without any effect. If the action raises `TcError`, an accepted telecommand has failed.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from enum import Enum
from typing import TypeVar

from fsw.telemetry.dictionary.codes import CommandOutcome, Error
from fsw.telemetry.link.downlink import Downlink
from fsw.telemetry.link.packets import Value
from fsw.telemetry.link.telecommands import (
    ACK_ACCEPTANCE,
    ACK_COMPLETION,
    ACK_PROGRESS,
    ACK_START,
    Request,
    RequestId,
    TcError,
    TelecommandReader,
)
from fsw.telemetry.services.request_words import argument_words
from fsw.telemetry.state.command_log import CommandLog, CommandRecord
from fsw.telemetry.state.event_reporter import EventReporter
from fsw.telemetry.state.mode_machine import ModeMachine

SECURITY_EVENTS = {
    Error.NOT_AUTHENTICATED: "TC_AUTH_FAILED",
    Error.REPLAY: "TC_AUTH_FAILED",
    Error.NOT_AUTHORISED: "TC_NOT_AUTHORISED",
    Error.NOT_KEPT: "TC_NOT_KEPT",
}


class Done(Enum):
    """Whether an action has completed the telecommand."""

    NOW = "now"
    LATER = "later"  # `finish` will complete it


Action = Callable[[], Done]
Handler = Callable[[Request], Action]
_Made = TypeVar("_Made")


def for_each(request: Request, prepare: Callable[[Request], _Made]) -> list[_Made]:
    """Return the result of `prepare` for every element of a repeated group.

    Raises
    ------
    TcError of the first rejected element; `argument` counts from the telecommand's first argument.
    """
    found = []
    width = len(request.telecommand.arguments) - 1
    for place, element in enumerate(request.elements):
        try:
            found.append(prepare(element))
        except TcError as error:
            if error.argument:
                error.argument += 1 + place * width
            raise
    return found


def each(handler: Handler) -> Handler:
    """Return a handler that checks all elements of a repeated group, then executes all of them."""

    def prepare(request: Request) -> Action:
        actions = for_each(request, handler)

        def act() -> Done:
            for action in actions:
                action()
            return Done.NOW

        return act

    return prepare


@dataclass(slots=True)
class TcCounters:
    """Counts of telecommands by outcome."""

    tc_packets: int = 0
    tc_accepted: int = 0
    tc_rejected: int = 0
    tc_completed: int = 0
    tc_failed: int = 0
    last_error: int = 0
    tc_not_authorised: int = 0


class TelecommandExecutor:
    """Checks telecommands, runs their handlers and sends the reports of service 1."""

    def __init__(
        self, mode_machine: ModeMachine, down: Downlink, reporter: EventReporter, log: CommandLog
    ) -> None:
        self._reader = TelecommandReader()
        self._handlers: dict[str, Handler] = {}
        self._mode_machine, self._down, self._reporter = mode_machine, down, reporter
        self._log = log
        self._waiting: dict[RequestId, CommandRecord] = {}
        self.counters = TcCounters()

    def add(self, handlers: Mapping[str, Handler]) -> None:
        """Add handlers by telecommand name; a telecommand without handler is NOT_SUPPORTED."""
        self._handlers.update(handlers)

    def check(self, packet: bytes) -> Request:
        """Return the request in a packet without doing anything. Raises TcError."""
        return self._reader.read(packet)

    def receive(self, packet: bytes, who: str = "") -> bool:
        """Check and execute one telecommand; return whether it was accepted.

        Parameters
        ----------
        who : client and key, or the part of the daemon that releases the telecommand
        """
        self.counters.tc_packets += 1
        request = None
        try:
            request = self._reader.read(packet)
            action = self._prepare(request)
        except Exception as error:  # noqa: BLE001 - no telecommand ends the service
            reason = TcError.of(error)
            words = f" ({who})" if who else ""
            passed = self._reject(RequestId.of(packet), reason, who=words)
            if request is not None and passed:
                name = request.telecommand.name
                self._log.rejected(who, name, argument_words(request), reason.error)
            return False
        self.counters.tc_accepted += 1
        self._success(request, "acceptance_success", ACK_ACCEPTANCE)
        self._success(request, "start_success", ACK_START)
        name, arguments = request.telecommand.name, argument_words(request)
        record = self._waiting[request.id] = self._log.begin(who, name, arguments)
        try:
            done = action()
        except Exception as error:  # noqa: BLE001 - no telecommand ends the service
            self.finish(request, TcError.of(error))
            return True
        if done is Done.NOW:
            self.finish(request)
        elif request.id in self._waiting:
            self._accepted(record)
        return True

    def open_record(self, who: str, name: str, arguments: str) -> CommandRecord:
        """Log and report the start of a command other than telecommands; `close_record` ends it."""
        record = self._log.begin(who, name, arguments)
        self._accepted(record)
        return record

    def close_record(self, record: CommandRecord, error: TcError | None) -> None:
        """Log and report the outcome of a command."""
        if error is None:
            self._log.end(record, CommandOutcome.COMPLETED, Error.NONE)
            self._reporter.report("TC_COMPLETED", record.words)
            return
        self._log.end(record, CommandOutcome.FAILED, error.error)
        self._reporter.report("TC_FAILED", f"{record.name}: {error} ({record.who})")

    def refuse(self, packet: bytes, error: Error, text: str, value: float = 0.0) -> None:
        """Count and report a packet that the uplink rejected."""
        self.counters.tc_packets += 1
        reason = TcError(error, value=value, text=text)
        self._reject(RequestId.of(packet), reason, known=len(packet) >= 4)

    def progress(self, request: Request, percent: int) -> None:
        """Report the progress of a request [%]."""
        if request.ack & ACK_PROGRESS and request.id in self._waiting:
            self._down.send("progress_success", _names(request.id) | {"step": percent})

    def finish(self, request: Request, error: TcError | None = None) -> None:
        """Complete a request, as failed if `error` is given; ignore one that is not waiting."""
        record = self._waiting.pop(request.id, None)
        if record is None:
            return
        if error is None:
            self.counters.tc_completed += 1
            self._success(request, "completion_success", ACK_COMPLETION)
        else:
            self.counters.tc_failed += 1
            self.counters.last_error = error.error
            self._down.send("completion_failure", _names(request.id) | _failure(error))
        self.close_record(record, error)

    def values(self) -> dict[str, int]:
        """Return the telecommand counters of housekeeping set 1."""
        counters = asdict(self.counters)
        del counters["tc_packets"], counters["tc_not_authorised"]
        return counters

    def link_values(self) -> dict[str, int]:
        """Return the telecommand counters of housekeeping set 8."""
        counters = self.counters
        return {
            "tc_packets": counters.tc_packets,
            "tc_not_authorised": counters.tc_not_authorised,
        }

    def reset_counters(self) -> None:
        """Set all counters to zero."""
        self.counters = TcCounters()

    def _prepare(self, request: Request) -> Action:
        telecommand = request.telecommand
        mode = self._mode_machine.mode
        if telecommand.accepted_in and mode.name not in telecommand.accepted_in:
            raise TcError(Error.WRONG_MODE, value=mode, text=f"{telecommand.name} in {mode.name}")
        if request.id in self._waiting:
            raise TcError(Error.BUSY, text="one of the same request id is not done yet")
        handler = self._handlers.get(telecommand.name)
        if handler is None:
            raise TcError(Error.NOT_SUPPORTED, text=telecommand.name)
        return handler(request)

    def _accepted(self, record: CommandRecord) -> None:
        self._log.keep(record)
        self._reporter.report("TC_ACCEPTED", record.words)

    def _reject(
        self, request_id: RequestId, error: TcError, *, known: bool = True, who: str = ""
    ) -> bool:
        """Report a rejection; return whether its event was reported, not left to a summary."""
        self.counters.tc_rejected += 1
        self.counters.last_error = error.error
        if known:
            routed = error.error is not Error.WRONG_APID
            name = "acceptance_failure" if routed else "routing_failure"
            self._down.send(name, _names(request_id) | _failure(error))
        self.counters.tc_not_authorised += error.error is Error.NOT_AUTHORISED
        code = SECURITY_EVENTS.get(error.error, "TC_REJECTED")
        return self._reporter.report(code, f"{error}{who}")

    def _success(self, request: Request, name: str, flag: int) -> None:
        if request.ack & flag:
            self._down.send(name, _names(request.id))


def _names(request_id: RequestId) -> dict[str, Value]:
    return {
        "request_packet_id": request_id.packet_id,
        "request_sequence": request_id.sequence,
    }


def _failure(error: TcError) -> dict[str, Value]:
    return {
        "error": int(error.error),
        "error_argument": error.argument,
        "error_value": error.value,
    }
