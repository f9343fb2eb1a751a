"""Service 6: check-sums of objects on board, which are tables and files (6,7 and 6,8).

The standard has two forms: raw memory by address (6,9), and objects by a base and offsets into
it (6,7). Tables and files are objects. The check-sum is the CRC-32 that tables and file delivery
use, where the standard's annex B proposes 16 bits. A file is read a piece at a time.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO

from fsw.telemetry.dictionary.codes import Error, Memory, Table
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler
from fsw.telemetry.services.filing import Filing
from fsw.telemetry.services.tables import Tables
from fsw.telemetry.tables.slot import Copy

PIECE_BYTES = 1 << 20


@dataclass(slots=True)
class _Running:
    request: Request
    file: BinaryIO
    left_bytes: int
    length: int
    crc32: int = 0


class ObjectChecksums:
    """Computes checksums, one file at a time.

    Parameters
    ----------
    filing : finds files by the names that the ground uses
    tables : the contents of tables
    """

    def __init__(self, context: TelemetryContext, filing: Filing, tables: Tables) -> None:
        self._context, self._filing, self._tables = context, filing, tables
        self._running: _Running | None = None

    def handlers(self) -> dict[str, Handler]:
        """Return the handler of this service's telecommand."""
        return {"CHECK_OBJECT": self._check}

    def poll(self) -> None:
        """Read one more piece of the file."""
        running = self._running
        if running is None:
            return
        try:
            piece = running.file.read(min(PIECE_BYTES, running.left_bytes))
        except OSError as error:
            self._finish(running, TcError(Error.FAILED, text=error.strerror or str(error)))
            return
        if not piece:
            self._finish(running, TcError(Error.FAILED, 2, text="the file has become shorter"))
            return
        running.crc32 = zlib.crc32(piece, running.crc32)
        running.left_bytes -= len(piece)
        if not running.left_bytes:
            self._send(running.request, running.length, running.crc32)
            self._finish(running, None)

    def _check(self, request: Request) -> Action:
        if request.whole("memory") == Memory.TABLES:
            return self._check_table(request)
        return self._check_file(request)

    def _check_table(self, request: Request) -> Action:
        table, copy = _table_copy(request.text("base"))
        content = self._tables.content(table, copy)
        offset, length = _part(request, len(content))

        def act() -> Done:
            self._send(request, length, zlib.crc32(content[offset : offset + length]))
            return Done.NOW

        return act

    def _check_file(self, request: Request) -> Action:
        path = self._filing.find(request.text("base"))
        if self._running is not None:
            raise TcError(Error.BUSY, text="another file is being checked")
        try:
            if not path.is_file():
                raise TcError(Error.FILE_NOT_FOUND, 2)
            size = path.stat().st_size
        except OSError as error:
            raise TcError(Error.FILE_NOT_FOUND, 2, text=error.strerror or "") from error
        offset, length = _part(request, size)
        return partial(self._begin, request, path, offset, length)

    def _begin(self, request: Request, path: Path, offset: int, length: int) -> Done:
        if not length:
            self._send(request, 0, 0)
            return Done.NOW
        try:
            file = path.open("rb")
            file.seek(offset)
        except OSError as error:
            raise TcError(Error.FAILED, 2, text=error.strerror or str(error)) from error
        self._running = _Running(request, file, length, length)
        return Done.LATER

    def _finish(self, running: _Running, error: TcError | None) -> None:
        running.file.close()
        self._running = None
        self._context.executor.finish(running.request, error)

    def _send(self, request: Request, length: int, crc32: int) -> None:
        values = {
            "memory": request.whole("memory"),
            "base": request.text("base"),
            "n": 1,
            "offset": request.whole("offset"),
            "length": length,
            "crc32": crc32,
        }
        self._context.send("object_checked", values)


def _table_copy(base: str) -> tuple[Table, Copy]:
    """Return what NAME/COPY stands for. Raises TcError."""
    name, _, copy = base.upper().partition("/")
    if name not in Table.__members__ or copy not in Copy.__members__:
        text = (
            f"{base!r}: NAME/COPY of {', '.join(Table.__members__)}; {', '.join(Copy.__members__)}"
        )
        raise TcError(Error.BAD_ARG, 2, text=text)
    return Table[name], Copy[copy]


def _part(request: Request, size: int) -> tuple[int, int]:
    """Return offset and length within an object of a size [B]. Raises TcError."""
    offset, length = request.whole("offset"), request.whole("length")
    if offset > size:
        raise TcError(Error.OUT_OF_RANGE, 4, offset, f"{size} bytes")
    length = length or size - offset
    if offset + length > size:
        raise TcError(Error.OUT_OF_RANGE, 5, length, f"{size} bytes")
    return offset, length
