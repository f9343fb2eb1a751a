"""Service 21: sequences of telecommands, each with the delay after it.

Loaded sequences survive a restart. Their execution does not: it is reported as aborted, because the
place reached is not stored. A sequence cannot start a sequence, so that none runs forever.
"""

import struct
import zlib
from dataclasses import dataclass
from functools import partial
from typing import Any

from fsw.telemetry.dictionary.codes import Error, SequenceStatus
from fsw.telemetry.dictionary.onboard_commands import DAY_S, MAX_SEQUENCES
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler
from fsw.telemetry.services.filing import Filing
from fsw.telemetry.services.kept_requests import checked_request, split_first
from fsw.telemetry.services.long_work import Pieces
from fsw.telemetry.state.documents import keep_document, read_document
from fsw.telemetry.state.store import GenerationStore

FOLDER = "sequences"
OWN_SERVICE = 21
MAX_ENTRIES = 64
MAX_BYTES = 16384
MAX_DELAY_MS = 1000 * DAY_S
MS = 1_000_000
DELAY_BYTES = 4


@dataclass(frozen=True, slots=True)
class Entry:
    """One telecommand and the delay after it."""

    packet: bytes
    delay_ms: int


@dataclass(slots=True)
class SequenceRun:
    """Progress of one execution."""

    due_ns: int
    place: int = 0  # index of the next entry


def parse_entries(data: bytes) -> tuple[Entry, ...]:
    """Return the entries in the bytes of a sequence, each a packet and its delay (u32) [ms].

    Raises
    ------
    TcError BAD_LENGTH or OUT_OF_RANGE, if bytes, entries or delays are out of bounds.
    """
    if not 0 < len(data) <= MAX_BYTES:
        raise TcError(Error.BAD_LENGTH, 2, len(data), f"1 to {MAX_BYTES} bytes of entries")
    entries: list[Entry] = []
    rest = data
    while rest:
        packet = split_first(rest)
        rest = rest[len(packet) :]
        if len(rest) < DELAY_BYTES:
            raise TcError(Error.BAD_LENGTH, 2, len(data), "the last delay is missing")
        (delay_ms,) = struct.unpack_from(">I", rest)
        rest = rest[DELAY_BYTES:]
        if delay_ms > MAX_DELAY_MS:
            raise TcError(Error.OUT_OF_RANGE, 2, delay_ms, f"delay: {MAX_DELAY_MS} ms at most")
        entries.append(Entry(packet, delay_ms))
        if len(entries) > MAX_ENTRIES:
            raise TcError(Error.OUT_OF_RANGE, 2, len(entries), f"{MAX_ENTRIES} entries at most")
    return tuple(entries)


class Sequences:
    """Stores sequences and executes them.

    Parameters
    ----------
    filing : finds files by the names that the ground uses
    """

    def __init__(self, context: TelemetryContext, filing: Filing) -> None:
        self._context, self._filing = context, filing
        folder = context.state / FOLDER
        numbers = range(1, MAX_SEQUENCES + 1)
        self._stores = {number: GenerationStore(folder / f"{number:02d}") for number in numbers}
        self._executing = GenerationStore(folder / "executing")
        self._loaded: dict[int, bytes] = {}
        self._entries: dict[int, tuple[Entry, ...]] = {}
        self._runs: dict[int, SequenceRun] = {}
        self._released: dict[int, int] = {}
        self._recall()

    def poll(self, now_ns: int) -> None:
        """Release at most one telecommand of each sequence, if it is due."""
        for number, run in list(self._runs.items()):
            if now_ns < run.due_ns or self._runs.get(number) is not run:
                continue
            entries = self._entries[number]
            entry = entries[run.place]
            run.place += 1
            run.due_ns += entry.delay_ms * MS
            self._released[number] = run.place
            if run.place == len(entries):
                self._end(number)
                self._context.report("SEQUENCE_ENDED", f"sequence {number}")
            self._context.executor.receive(entry.packet, f"sequence {number}")

    def digest(self) -> list[object]:
        """Return all state that telecommands can change, as plain values."""
        crcs = {number: zlib.crc32(data) for number, data in self._loaded.items()}
        return [crcs, {number: run.place for number, run in self._runs.items()}]

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of this service's telecommands."""
        return {
            "LOAD_SEQUENCE": lambda request: self._load(request, request.data),
            "LOAD_SEQUENCE_FILE": self._load_file,
            "UNLOAD_SEQUENCE": self._unload,
            "START_SEQUENCE": self._start,
            "ABORT_SEQUENCE": self._abort,
            "REPORT_SEQUENCES": partial(self._context.long_work.action, make=self._status),
            "CHECK_SEQUENCE": self._check,
            "REPORT_SEQUENCE": self._report_content,
            "ABORT_SEQUENCES": lambda _: self._abort_all,
        }

    def _checked(self, data: bytes) -> tuple[Entry, ...]:
        entries = parse_entries(data)
        for entry in entries:
            checked_request(self._context.executor, entry.packet, 2, (OWN_SERVICE,))
        return entries

    def _load(self, request: Request, data: bytes) -> Action:
        number = request.whole("sequence")
        self._must_rest(number)
        entries = self._checked(data)

        def act() -> Done:
            self._keep(number, data)
            self._loaded[number], self._entries[number] = data, entries
            self._released.pop(number, None)
            text = f"sequence {number}: {len(entries)} entries, CRC-32 {zlib.crc32(data):08x}"
            self._context.report("SEQUENCE_LOADED", text)
            return Done.NOW

        return act

    def _load_file(self, request: Request) -> Action:
        path = self._filing.find(request.text("path"))
        try:
            if not path.is_file():
                raise TcError(Error.FILE_NOT_FOUND, 2)
            with path.open("rb") as file:
                data = file.read(MAX_BYTES + 1)
        except OSError as error:
            raise TcError(Error.FILE_NOT_FOUND, 2, text=error.strerror or "") from error
        return self._load(request, data)

    def _unload(self, request: Request) -> Action:
        number = self._known(request)
        self._must_rest(number)

        def act() -> Done:
            self._keep(number, b"")
            for held in (self._loaded, self._entries, self._released):
                held.pop(number, None)
            return Done.NOW

        return act

    def _start(self, request: Request) -> Action:
        number = self._known(request)
        self._must_rest(number)

        def act() -> Done:
            self._note({*self._runs, number})
            self._runs[number] = SequenceRun(self._context.now_ns())
            self._released[number] = 0
            self._context.report("SEQUENCE_STARTED", f"sequence {number}")
            return Done.NOW

        return act

    def _abort(self, request: Request) -> Action:
        number = self._known(request)
        if number not in self._runs:
            raise TcError(Error.NOT_STAGED, 1, number, "it does not execute")

        def act() -> Done:
            self._end(number)
            self._context.report("SEQUENCE_ABORTED", f"sequence {number}")
            return Done.NOW

        return act

    def _abort_all(self) -> Done:
        numbers = sorted(self._runs)
        for number in numbers:
            self._end(number)
            self._context.report("SEQUENCE_ABORTED", f"sequence {number}")
            self._context.down.send("sequence_aborted", {"n": 1, "sequence": number})
        if not numbers:
            self._context.down.send("sequence_aborted", {"n": 0, "sequence": 0})
        return Done.NOW

    def _check(self, request: Request) -> Action:
        number = self._known(request)

        def act() -> Done:
            data = self._loaded[number]
            values = {"crc32": zlib.crc32(data), "size_bytes": len(data)}
            self._context.down.send("sequence_checked", {"sequence": number} | values)
            return Done.NOW

        return act

    def _status(self) -> Pieces:
        if not self._loaded:
            yield (
                "sequence_status",
                dict.fromkeys(("n", "sequence", "status", "released", "entries"), 0),
            )
        for number, entries in sorted(self._entries.items()):
            executing = number in self._runs
            values = {
                "n": 1,
                "sequence": number,
                "status": SequenceStatus.EXECUTING if executing else SequenceStatus.INACTIVE,
                "released": self._released.get(number, 0),
                "entries": len(entries),
            }
            yield "sequence_status", values

    def _report_content(self, request: Request) -> Action:
        number = self._known(request)
        return self._context.long_work.action(request, partial(self._content, number))

    def _content(self, number: int) -> Pieces:
        entries = self._entries[number]
        for place, entry in enumerate(entries, start=1):
            values = {"sequence": number, "n": len(entries), "entry": place}
            values |= {"delay_ms": entry.delay_ms}
            yield "sequence_entry", {**values, "request_hex": entry.packet.hex()}

    def _known(self, request: Request) -> int:
        number = request.whole("sequence")
        if number not in self._loaded:
            raise TcError(Error.NOT_STAGED, 1, number, "no sequence is loaded there")
        return number

    def _must_rest(self, number: int) -> None:
        if number in self._runs:
            raise TcError(Error.BUSY, 1, number, "it executes")

    def _keep(self, number: int, data: bytes) -> None:
        try:
            self._stores[number].write(data)
        except OSError as error:
            raise TcError(Error.FAILED, text=f"cannot be kept: {error.strerror}") from error

    def _end(self, number: int) -> None:
        del self._runs[number]
        try:
            self._note(set(self._runs))
        except TcError as error:
            self._context.report("TC_FAILED", f"sequences: {error}")

    def _note(self, numbers: set[int]) -> None:
        """Store which sequences execute, for the report after a restart."""
        keep_document(self._executing, sorted(numbers))

    def _recall(self) -> None:
        """Read the sequences of the last run; report those that were executing then."""
        damaged = 0
        for number, store in self._stores.items():
            generations, bad = store.read()
            damaged += bad
            for generation in generations:
                if not generation.content:
                    break  # it was unloaded
                try:
                    self._entries[number] = self._checked(generation.content)
                except TcError:
                    damaged += 1
                    continue
                self._loaded[number] = generation.content
                break
        executing, bad = read_document(self._executing, _numbers)
        if damaged + bad:
            text = f"sequences: {damaged + bad} generations cannot be read"
            self._context.report("STORED_REQUESTS_CORRUPT", text)
        for number in executing or ():
            self._context.report("SEQUENCE_ABORTED", f"sequence {number}: the daemon restarted")
        if executing:
            try:
                self._note(set())
            except TcError as error:
                self._context.report("TC_FAILED", f"sequences: {error}")


def _numbers(document: Any) -> list[int]:  # noqa: ANN401
    """Return the sequence numbers in a document. Raises TypeError."""
    if not isinstance(document, list) or any(not isinstance(item, int) for item in document):
        raise TypeError("must be a list of whole numbers")
    return document
