"""Forwards telecommands to the loop, and completes them by the loop's replies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from fsw.messages.commands import JOBS, Code, Command, CommandName, JobReport, Reply
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.ports import Host
from fsw.telemetry.services.executor import Done, TelecommandExecutor
from fsw.telemetry.state.command_log import CommandRecord
from fsw.telemetry.state.mode_machine import ModeMachine

FIRST_ID = 1 << 20  # the control socket uses the numbers below
TIMEOUT_NS = 5_000_000_000
STEP_PERCENT = 10  # between progress reports
ERRORS = {
    Code.BAD_ARGUMENT: Error.BAD_ARG,
    Code.QUEUE_FULL: Error.BUSY,
    Code.JOB_RUNNING: Error.BUSY,
    Code.NO_JOB: Error.NOT_STAGED,
    Code.NO_RESULT: Error.NOT_STAGED,
    Code.NO_STATE: Error.NOT_STAGED,
    Code.NOT_SUPPORTED: Error.NOT_SUPPORTED,
    Code.TIMEOUT: Error.TIMEOUT,
}
OUTCOMES = ("NOT_CONVERGED", "INSUFFICIENT_EXCITATION")  # errors named only in a reply's text

Then = Callable[[Reply], None]
Order = tuple[CommandName, dict[str, object]]


@dataclass(slots=True)
class _Waiting:
    request: Request | CommandRecord | None
    since_ns: int
    rest: list[Order]  # commands to forward after this one is accepted
    then: Then | None = None
    failed: Callable[[], None] | None = None


@dataclass(slots=True)
class _Job:
    request: Request
    step: int = field(default=0)


class LoopCommands:
    """Forwards commands to the loop and waits for their replies.

    Parameters
    ----------
    host : forwards commands to the loop
    mode_machine : records the effect of commands that the loop has applied

    Attributes
    ----------
    restart_commanded : whether the loop has accepted RESTART
    """

    def __init__(
        self, host: Host, executor: TelecommandExecutor, mode_machine: ModeMachine
    ) -> None:
        self._host, self._executor, self._mode_machine = host, executor, mode_machine
        self.restart_commanded = False
        self._waiting: dict[int, _Waiting] = {}
        self._jobs: dict[int, _Job] = {}
        self._next = FIRST_ID

    def order(
        self,
        request: Request | CommandRecord | None,
        orders: Sequence[Order],
        then: Then | None = None,
        failed: Callable[[], None] | None = None,
    ) -> Done:
        """Forward commands in order, each after the command before was accepted.

        Parameters
        ----------
        request : the telecommand or logged command to complete at the end; None: neither
        then : called with the last reply, before the request is finished; may raise TcError
        failed : called when a command was rejected or failed

        Raises
        ------
        TcError BUSY when the first command cannot be forwarded.
        """
        waiting = _Waiting(request, self._host.now_ns(), list(orders), then, failed)
        self._send_next(waiting)
        return Done.LATER

    def reply(self, reply: Reply) -> None:
        """Complete, continue or fail the request of a reply; ignore replies to other commands."""
        if reply.accepted and reply.command:
            self._applied(CommandName(reply.command))
        waiting = self._waiting.pop(reply.id, None)
        if waiting is None:
            return
        if not reply.accepted:
            self._fail(waiting, error_of(reply.code, reply.text))
            return
        request = waiting.request
        if reply.command in JOBS and isinstance(request, Request):
            self._jobs[reply.id] = _Job(request)
            return
        try:
            if waiting.rest:
                self._send_next(waiting)
                return
            if waiting.then is not None:
                waiting.then(reply)
        except Exception as error:  # noqa: BLE001 - no telecommand ends the service
            self._fail(waiting, TcError.of(error))
            return
        self._finish(waiting.request, None)

    def job(self, report: JobReport) -> None:
        """Report the progress of a batch job [%], or complete its telecommand at the end."""
        job = self._jobs.get(report.id)
        if job is None:
            return
        if report.state == "running":
            percent = round(100 * report.progress)
            if percent >= job.step + STEP_PERCENT:
                job.step = percent
                self._executor.progress(job.request, percent)
            return
        del self._jobs[report.id]
        status = str((report.result or {}).get("status", report.text))
        if report.state == "done" and status == "OK":
            self._finish(job.request, None)
        else:
            self._finish(job.request, error_of(Code.ESTIMATOR, f"{report.state} {status}"))

    def poll(self) -> None:
        """Fail the requests that the loop has not answered within `TIMEOUT_NS`."""
        now_ns = self._host.now_ns()
        late = [n for n, item in self._waiting.items() if now_ns - item.since_ns > TIMEOUT_NS]
        for number in late:
            waiting = self._waiting.pop(number)
            self._fail(waiting, TcError(Error.TIMEOUT, text="the loop did not answer"))

    def _applied(self, name: CommandName) -> None:
        """Record the effect of a command that the loop has applied, whichever client sent it."""
        if name in (CommandName.REST, CommandName.RESUME):
            self._mode_machine.identifying(name is CommandName.RESUME)
        elif name in JOBS:
            self._mode_machine.job(True)
        elif name is CommandName.RESTART:
            self.restart_commanded = True

    def _send_next(self, waiting: _Waiting) -> None:
        name, args = waiting.rest.pop(0)
        number, self._next = self._next, self._next + 1
        if not self._host.forward(Command(name=name, id=number, args=args)):
            raise TcError(Error.BUSY, text="the ring to the loop is full")
        waiting.since_ns = self._host.now_ns()
        self._waiting[number] = waiting

    def _fail(self, waiting: _Waiting, error: TcError) -> None:
        if waiting.failed is not None:
            try:
                waiting.failed()
            except Exception as also:  # noqa: BLE001 - no telecommand ends the service
                error = TcError.of(also)
        self._finish(waiting.request, error)

    def _finish(self, request: Request | CommandRecord | None, error: TcError | None) -> None:
        if isinstance(request, Request):
            self._executor.finish(request, error)
        elif request is not None:
            self._executor.close_record(request, error)


def error_of(code: Code, text: str) -> TcError:
    """Return the TcError for code and text of a rejecting reply of the loop."""
    for outcome in OUTCOMES:
        if outcome in text:
            return TcError(Error[outcome], text=text)
    return TcError(ERRORS.get(code, Error.FAILED), text=text)
