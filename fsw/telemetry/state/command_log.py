"""Log of commands with sender, time and outcome; the log survives a restart."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from fsw.telemetry.dictionary.codes import CommandOutcome, Error
from fsw.telemetry.ports import Host
from fsw.telemetry.state.fair_log import FairLog
from fsw.telemetry.state.journal import Journal

COMMANDS_NAME = "commands.jsonl"
CAPACITY = 1000
LIMIT_BYTES = 1 << 20
MAX_ARGUMENTS_CHARACTERS = 400
REJECTED = "rejected"  # kind of all rejected commands: they share their part of the log


@dataclass(slots=True, kw_only=True)
class CommandRecord:
    """One command; `time_s` is mission elapsed time, `unix_s` is Unix time."""

    boot_count: int
    number: int  # in its run
    time_s: float
    unix_s: float
    who: str
    name: str
    arguments: str
    outcome: str = CommandOutcome.ACCEPTED.name
    error: str = Error.NONE.name
    duration_s: float = 0.0

    @property
    def words(self) -> str:
        """Return name, arguments and sender as text."""
        return f"{' '.join((self.name, self.arguments)).strip()} ({self.who})"


RECORD = TypeAdapter(CommandRecord)


class CommandLog:
    """Keeps the newest commands in memory, and all commands in files of bounded size.

    Parameters
    ----------
    state : directory of the file
    boot_count : number of the current start of the daemon
    reserve_bytes : free space of the disk that the file leaves alone [B]
    """

    def __init__(self, state: Path, boot_count: int, host: Host, reserve_bytes: int = 0) -> None:
        self._host, self._boot_count = host, boot_count
        self._journal = Journal(state / COMMANDS_NAME, LIMIT_BYTES, reserve_bytes)
        self._log: FairLog[CommandRecord] = FairLog(CAPACITY)
        self._number = 0
        for record in _records(self._journal.read()):
            self._log.add(_kind(record), record)
            if record.boot_count == boot_count:
                self._number = max(self._number, record.number)

    @property
    def files(self) -> tuple[Path, Path]:
        """Return the files of the log."""
        return self._journal.files

    def begin(self, who: str, name: str, arguments: str) -> CommandRecord:
        """Record an accepted command in memory; return its record."""
        record = self._made(who, name, arguments)
        self._log.add(_kind(record), record)
        return record

    def keep(self, record: CommandRecord) -> None:
        """Append a command to the file: at its end, and at its start if it takes long."""
        self._journal.append(asdict(record))

    def end(self, record: CommandRecord, outcome: CommandOutcome, error: Error) -> None:
        """Record the outcome and the duration of a command, and write both to the file."""
        record.outcome, record.error = outcome.name, error.name
        record.duration_s = self._host.now_ns() * 1e-9 - record.time_s
        self.keep(record)

    def rejected(self, who: str, name: str, arguments: str, error: Error) -> None:
        """Record a rejected command in memory and in the file."""
        record = self._made(who, name, arguments)
        record.outcome, record.error = CommandOutcome.REJECTED.name, error.name
        self._log.add(_kind(record), record)
        self.keep(record)

    def newest(self, count: int) -> list[CommandRecord]:
        """Return at most `count` newest commands, oldest first."""
        return self._log.newest(count)

    def packets(self, count: int) -> Iterator[tuple[str, Mapping[str, object]]]:
        """Yield name and values of a packet per command, oldest first; one for an empty log."""
        newest = self.newest(count)
        for place, record in enumerate(newest, start=1):
            yield "command_log_entry", _values(record) | {"entry": place, "entries": len(newest)}
        if not newest:
            empty = CommandRecord(
                boot_count=0, number=0, time_s=0.0, unix_s=0.0, who="", name="", arguments=""
            )
            yield "command_log_entry", _values(empty) | {"entry": 0, "entries": 0}

    def _made(self, who: str, name: str, arguments: str) -> CommandRecord:
        self._number += 1
        now_ns = self._host.now_ns()
        return CommandRecord(
            boot_count=self._boot_count,
            number=self._number,
            time_s=now_ns * 1e-9,
            unix_s=(now_ns + self._host.epoch().utc_less_met_ns) * 1e-9,
            who=who or "on board",
            name=name,
            arguments=arguments[:MAX_ARGUMENTS_CHARACTERS],
        )


def _kind(record: CommandRecord) -> str:
    return REJECTED if record.outcome == CommandOutcome.REJECTED.name else record.name


def _values(record: CommandRecord) -> dict[str, object]:
    return {
        "boot_count": record.boot_count,
        "time_s": record.time_s,
        "unix_s": record.unix_s,
        "duration_s": record.duration_s,
        "outcome": int(CommandOutcome[record.outcome]),
        "error": int(Error[record.error]),
        "who": record.who,
        "command": record.name,
        "arguments": record.arguments,
    }


def _records(lines: list[dict[str, Any]]) -> list[CommandRecord]:
    """Return the commands of stored lines; a command without an end becomes INTERRUPTED."""
    found: dict[tuple[int, int], CommandRecord] = {}
    for line in lines[-4 * CAPACITY :]:
        try:
            record = RECORD.validate_python(line)
            _values(record)
        except (KeyError, ValueError):
            continue
        found[record.boot_count, record.number] = record
    for record in found.values():
        if record.outcome == CommandOutcome.ACCEPTED.name:
            record.outcome = CommandOutcome.INTERRUPTED.name
    return list(found.values())
