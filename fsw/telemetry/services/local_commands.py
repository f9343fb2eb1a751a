"""Commands of the local control socket, noted in the same history as telecommands."""

from __future__ import annotations

from fsw.messages.commands import Command, Reply
from fsw.telemetry.dictionary.codes import CommandOutcome, Error
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.state.command_log import CommandRecord

MAX_WAITING = 64  # commands whose reply is awaited


class LocalCommands:
    """Records commands of the control socket and reports their end."""

    def __init__(self, context: TelemetryContext) -> None:
        self._context = context
        self._waiting: dict[int, CommandRecord] = {}  # by the command's id

    def begin(self, command: Command) -> None:
        """Record a command; its reply ends it."""
        arguments = " ".join(f"{name}={value}" for name, value in command.args.items())
        name = str(command.name).upper()
        self._waiting[command.id] = self._context.log.begin("local socket", name, arguments)
        if len(self._waiting) > MAX_WAITING:
            del self._waiting[next(iter(self._waiting))]

    def reply(self, reply: Reply) -> None:
        """Record and report the outcome of a command; ignore replies to telecommands."""
        record = self._waiting.pop(reply.id, None)
        if record is None:
            return
        if reply.accepted:
            self._context.log.end(record, CommandOutcome.COMPLETED, Error.NONE)
            self._context.report("TC_COMPLETED", record.words)
        else:
            self._context.log.end(record, CommandOutcome.FAILED, Error.FAILED)
            self._context.report("TC_FAILED", f"{record.name}: {reply.text} ({record.who})")
