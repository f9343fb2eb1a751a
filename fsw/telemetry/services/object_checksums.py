"""Service 6: checksums of objects on board, which are tables and files (6,7 and 6,8).

The standard has two forms: raw memory by address (6,9), and objects by base and offset (6,7).
Tables and files are objects. The checksum is the CRC-32 that tables and file delivery use; annex B
of the standard proposes 16 bits instead. A file is read a piece at a time.
"""

import zlib

from fsw.telemetry.dictionary.codes import Error, Memory, Table
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler
from fsw.telemetry.services.file_pieces import checksum
from fsw.telemetry.services.filing import Filing
from fsw.telemetry.services.long_work import Packet, Pieces
from fsw.telemetry.services.tables import Tables
from fsw.telemetry.tables.slot import Copy


class ObjectChecksums:
    """Computes checksums, of one file at a time.

    Parameters
    ----------
    filing : finds files by the names that the ground uses
    tables : returns the contents of tables
    """

    def __init__(self, context: TelemetryContext, filing: Filing, tables: Tables) -> None:
        self._context, self._filing, self._tables = context, filing, tables

    def handlers(self) -> dict[str, Handler]:
        """Return the handler of this service's telecommand."""
        return {"CHECK_OBJECT": self._check}

    def _check(self, request: Request) -> Action:
        if request.whole("memory") == Memory.TABLES:
            return self._check_table(request)
        return self._check_file(request)

    def _check_table(self, request: Request) -> Action:
        table, copy = _table_copy(request.text("base"))
        content = self._tables.content(table, copy)
        offset, length = _part(request, len(content))

        def act() -> Done:
            crc32 = zlib.crc32(content[offset : offset + length])
            self._context.down.send(*self._checked(request, length, crc32))
            return Done.NOW

        return act

    def _check_file(self, request: Request) -> Action:
        path = self._filing.find(request.text("base"))
        try:
            if not path.is_file():
                raise TcError(Error.FILE_NOT_FOUND, 2)
            size = path.stat().st_size
        except OSError as error:
            raise TcError(Error.FILE_NOT_FOUND, 2, text=error.strerror or "") from error
        offset, length = _part(request, size)

        def pieces() -> Pieces:
            crc32 = yield from checksum(path, offset, length)
            yield self._checked(request, length, crc32)

        return self._context.long_work.action(request, pieces)

    def _checked(self, request: Request, length: int, crc32: int) -> Packet:
        values = {
            "memory": request.whole("memory"),
            "base": request.text("base"),
            "n": 1,
            "offset": request.whole("offset"),
            "length": length,
            "crc32": crc32,
        }
        return "object_checked", values


def _table_copy(base: str) -> tuple[Table, Copy]:
    """Return the table and the copy for a text NAME/COPY. Raises TcError."""
    name, _, copy = base.upper().partition("/")
    if name not in Table.__members__ or copy not in Copy.__members__:
        text = (
            f"{base!r}: NAME/COPY of {', '.join(Table.__members__)}; {', '.join(Copy.__members__)}"
        )
        raise TcError(Error.BAD_ARG, 2, text=text)
    return Table[name], Copy[copy]


def _part(request: Request, size: int) -> tuple[int, int]:
    """Return offset and length of a part of an object of `size` bytes [B]. Raises TcError."""
    offset, length = request.whole("offset"), request.whole("length")
    if offset > size:
        raise TcError(Error.OUT_OF_RANGE, 4, offset, f"{size} bytes")
    length = length or size - offset
    if offset + length > size:
        raise TcError(Error.OUT_OF_RANGE, 5, length, f"{size} bytes")
    return offset, length
