"""Loads, validates, activates (between two ticks), dumps, aborts and rolls back tables.

An active table is a generation on the disk; a staged one is in memory only. After a power cut
either the old table or the new one is active.
"""

import zlib
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from fsw.errors import ConfigError
from fsw.telemetry.dictionary.codes import Error, Table
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler
from fsw.telemetry.services.filing import Filing
from fsw.telemetry.state.store import GenerationStore
from fsw.telemetry.tables.content import SUFFIX
from fsw.telemetry.tables.effective import TABLES
from fsw.telemetry.tables.effects import TableEffects
from fsw.telemetry.tables.slot import Copy, Slot, TableState

MAX_BYTES = 1 << 20


class Tables:
    """Holds the staged and active tables, and handles the telecommands on tables.

    Parameters
    ----------
    effects : validates contents and puts them into use
    filing : finds files by the names that the ground uses
    """

    def __init__(self, context: TelemetryContext, effects: TableEffects, filing: Filing) -> None:
        self._context, self._effects, self._filing = context, effects, filing
        self._dumps = context.state / context.telemetry.file_directory / TABLES
        directory = context.state / TABLES
        self._slots = {t: Slot(GenerationStore(directory / t.name.lower())) for t in Table}
        for table, slot in self._slots.items():
            damaged = slot.recall(partial(effects.validate, table))
            if damaged:
                text = f"{table.name}: {damaged} generations cannot be used"
                context.report("TABLE_CORRUPT", text)
        for table in Table:
            if self.active(table):
                effects.recall(table, self.active(table))

    def active(self, table: Table) -> bytes:
        """Return the uploaded table in use; empty if the configuration's values are in use."""
        return self._slots[table].active

    def values(self) -> dict[str, Any]:
        """Return the fields of housekeeping set 6."""
        return {
            f"{table.name.lower()}_{key}": value
            for table, slot in self._slots.items()
            for key, value in slot.values().items()
        }

    def content(self, table: Table, copy: Copy) -> bytes:
        """Return a copy of a table; without an uploaded one, the active copy is as configured.

        Raises
        ------
        TcError NOT_STAGED if the copy does not exist.
        """
        slot = self._slots[table]
        if copy is Copy.ACTIVE:
            return slot.active or self._effects.dump(table)
        content = bytes(slot.staged) if copy is Copy.STAGED else slot.previous
        if content is None or (copy is Copy.STAGED and not content):
            raise TcError(Error.NOT_STAGED, 1, table)
        return content

    def replace(self, table: Table, content: bytes) -> None:
        """Store a content, which the caller puts into use, as the newest generation.

        Raises
        ------
        TcError if the table is being activated or cannot be stored; then nothing has changed.
        """
        slot = self._slots[table]
        if slot.state is TableState.ACTIVATING:
            raise TcError(Error.BUSY, text=f"{table.name} is being activated")
        try:
            number = slot.store.write(content)
        except OSError as error:
            raise TcError(Error.FAILED, text=f"cannot be kept: {error.strerror}") from error
        slot.previous, slot.active, slot.generation = slot.active, content, number

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of the table functions of service 8."""
        steps: Mapping[str, Callable[[Request, Table, Slot], Action]] = {
            "TBL_LOAD": self._load,
            "TBL_DATA": self._data,
            "TBL_LOAD_FILE": self._load_file,
            "TBL_VALIDATE": self._check,
            "TBL_ACTIVATE": self._activate,
            "TBL_DUMP": self._dump,
            "TBL_ABORT": self._abort,
            "TBL_ROLLBACK": self._rollback,
        }
        return {name: partial(self._step, step) for name, step in steps.items()}

    def _step(self, step: Callable[[Request, Table, Slot], Action], request: Request) -> Action:
        table = Table(request.whole("table"))
        slot = self._slots[table]
        if slot.state is TableState.ACTIVATING:
            raise TcError(Error.BUSY, 1, table, "it is being activated")
        action = step(request, table, slot)

        def act() -> Done:
            try:
                return action()
            except TcError as error:
                slot.error = error.error
                raise

        return act

    def _load(self, request: Request, table: Table, slot: Slot) -> Action:
        size, crc32 = request.whole("size_bytes"), request.whole("crc32")

        def act() -> Done:
            slot.drop()
            slot.state, slot.size, slot.crc32 = TableState.LOADING, size, crc32
            return Done.NOW

        _ = table
        return act

    def _data(self, request: Request, table: Table, slot: Slot) -> Action:
        offset, data = request.whole("offset"), request.data
        if slot.state is not TableState.LOADING:
            raise TcError(Error.NOT_STAGED, 1, table, "no load was begun")
        if offset > len(slot.staged) or offset + len(data) > slot.size:
            raise TcError(Error.OUT_OF_RANGE, 2, offset, f"{len(slot.staged)} of {slot.size} held")

        def act() -> Done:
            slot.staged[offset : offset + len(data)] = data
            if len(slot.staged) == slot.size:
                self._staged(table, slot)
            return Done.NOW

        return act

    def _load_file(self, request: Request, table: Table, slot: Slot) -> Action:
        path = self._filing.find(request.text("path"))
        if not path.is_file():
            raise TcError(Error.FILE_NOT_FOUND, 3)
        if path.stat().st_size > MAX_BYTES:
            raise TcError(Error.OUT_OF_RANGE, 3, path.stat().st_size)

        def act() -> Done:
            slot.drop()
            try:
                slot.staged = bytearray(path.read_bytes())
            except OSError as error:
                raise TcError(Error.FILE_NOT_FOUND, 3) from error
            slot.size, slot.crc32 = len(slot.staged), request.whole("crc32")
            self._staged(table, slot)
            return Done.NOW

        return act

    def _staged(self, table: Table, slot: Slot) -> None:
        found = zlib.crc32(slot.staged)
        if found != slot.crc32:
            slot.drop()
            raise TcError(Error.CRC_MISMATCH, value=found)
        slot.state = TableState.STAGED
        self._context.report("TABLE_LOADED", f"{table.name}, {slot.size} bytes, CRC-32 {found:08x}")

    def _check(self, request: Request, table: Table, slot: Slot) -> Action:
        if slot.state not in (TableState.STAGED, TableState.VALIDATED):
            raise TcError(Error.NOT_STAGED, 1, table)

        def act() -> Done:
            try:
                self._effects.validate(table, bytes(slot.staged))
            except ConfigError as error:
                self._context.report("TABLE_INVALID", f"{table.name}: {error}")
                raise TcError(Error.NOT_VALIDATED, 1, table, str(error)) from error
            slot.state = TableState.VALIDATED
            self._context.report("TABLE_VALIDATED", table.name)
            return Done.NOW

        _ = request
        return act

    def _activate(self, request: Request, table: Table, slot: Slot) -> Action:
        if slot.state not in (TableState.STAGED, TableState.VALIDATED):
            raise TcError(Error.NOT_STAGED, 1, table)
        if slot.state is not TableState.VALIDATED:
            raise TcError(Error.NOT_VALIDATED, 1, table)
        if zlib.crc32(slot.staged) != request.whole("crc32"):
            raise TcError(Error.CRC_MISMATCH, 2, zlib.crc32(slot.staged))
        self._one_at_a_time(table)
        return partial(self._put_in_force, request, table, slot, bytes(slot.staged))

    def _rollback(self, request: Request, table: Table, slot: Slot) -> Action:
        if slot.previous is None:
            raise TcError(Error.NOT_STAGED, 1, table, "there is none before this one")
        self._one_at_a_time(table)
        return partial(self._put_in_force, request, table, slot, slot.previous)

    def _one_at_a_time(self, table: Table) -> None:
        """Raise TcError BUSY while any table is being activated: an activation uses all tables."""
        if any(slot.state is TableState.ACTIVATING for slot in self._slots.values()):
            raise TcError(Error.BUSY, 1, table, "another one is being activated")

    def _put_in_force(self, request: Request, table: Table, slot: Slot, content: bytes) -> Done:
        """Write a content to the disk, apply it, and only then make it the newest generation."""
        try:
            number = slot.store.prepare(content)
        except OSError as error:
            raise TcError(Error.FAILED, text=f"cannot be kept: {error.strerror}") from error
        before, slot.state = slot.state, TableState.ACTIVATING
        contents = {other: self.active(other) for other in Table} | {table: content}

        def commit() -> None:
            slot.state = before
            try:
                slot.store.commit(number)
            except OSError as error:
                raise TcError(Error.FAILED, text=f"cannot be kept: {error.strerror}") from error
            slot.previous, slot.active, slot.generation = slot.active, content, number
            slot.drop()
            self._context.report("TABLE_ACTIVATED", f"{table.name}, generation {number}")

        def failed() -> None:
            slot.state = before
            slot.store.discard()

        try:
            return self._effects.apply(table, contents, request, commit, failed)
        except ConfigError as error:
            failed()
            raise TcError(Error.NOT_VALIDATED, 1, table, str(error)) from error
        except Exception:
            failed()
            raise

    def _dump(self, request: Request, table: Table, slot: Slot) -> Action:
        copy = Copy(request.whole("copy"))
        content = self.content(table, copy)

        def act() -> Done:
            path = self._dumps / f"{table.name.lower()}_{copy.name.lower()}.{SUFFIX[table]}"
            try:
                self._dumps.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            except OSError as error:
                raise TcError(Error.FAILED, text=f"{path}: {error.strerror}") from error
            values = {"table": int(table), "crc32": zlib.crc32(content)}
            values |= {"size_bytes": len(content)}
            name = f"files/{self._dumps.name}/{path.name}"  # the name that the ground uses
            self._context.down.send("table_dumped", {**values, "path": name})
            self._context.report("TABLE_DUMPED", f"{table.name} {copy.name}")
            return Done.NOW

        _ = slot
        return act

    def _abort(self, request: Request, table: Table, slot: Slot) -> Action:
        if slot.state is TableState.ACTIVE:
            raise TcError(Error.NOT_STAGED, 1, table)

        def act() -> Done:
            slot.drop()
            self._context.report("TABLE_ABORTED", table.name)
            return Done.NOW

        _ = request
        return act
