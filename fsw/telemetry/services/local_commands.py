"""Commands of the local control socket, recorded in the same log as telecommands."""

from dataclasses import dataclass

from fsw.messages.commands import Command, Reply
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.telecommands import TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.loop_commands import TIMEOUT_NS, error_of
from fsw.telemetry.state.command_log import CommandRecord


@dataclass(frozen=True, slots=True)
class _Waiting:
    record: CommandRecord
    since_ns: int


class LocalCommands:
    """Records commands of the control socket and reports their end."""

    def __init__(self, context: TelemetryContext) -> None:
        self._context = context
        self._waiting: dict[int, _Waiting] = {}  # by the command's id

    def begin(self, command: Command) -> None:
        """Record the start of a command; the loop's reply ends the command."""
        arguments = " ".join(f"{name}={value}" for name, value in command.args.items())
        name = str(command.name).upper()
        record = self._context.executor.open_record("local socket", name, arguments)
        self._waiting[command.id] = _Waiting(record, self._context.now_ns())

    def reply(self, reply: Reply) -> None:
        """Record and report the outcome of a command; ignore replies to telecommands."""
        error = None if reply.accepted else error_of(reply.code, reply.text)
        self._end(reply.id, error)

    def poll(self, now_ns: int) -> None:
        """Fail the commands that the loop has not answered within `TIMEOUT_NS`."""
        late = [n for n, item in self._waiting.items() if now_ns - item.since_ns > TIMEOUT_NS]
        for number in late:
            self._end(number, TcError(Error.TIMEOUT, text="the loop did not answer"))

    def _end(self, number: int, error: TcError | None) -> None:
        waiting = self._waiting.pop(number, None)
        if waiting is not None:
            self._context.executor.close_record(waiting.record, error)
