"""Work on files a piece at a time: checksums, copies and appending, as generators.

Each generator yields None after a piece, so that the caller decides when to do the next piece. A
generator that is closed before its end leaves no partial result.
"""

import zlib
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import BinaryIO

from file_delivery.paths import HIDDEN
from file_delivery.room import check_room
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.telecommands import TcError

PIECE_BYTES = 1 << 16
COPYING = f"{HIDDEN}copying"  # name of an incomplete copy, in the folder of its target


def checksum(path: Path, offset: int, length: int) -> Generator[None, None, int]:
    """Return the CRC-32 of `length` bytes of a file from `offset` on [B].

    Raises
    ------
    OSError, and TcError FAILED if the file ends within this part.
    """
    crc32 = 0
    with path.open("rb") as file:
        file.seek(offset)
        while length:
            piece = file.read(min(PIECE_BYTES, length))
            if not piece:
                raise TcError(Error.FAILED, text="the file has become shorter")
            crc32 = zlib.crc32(piece, crc32)
            length -= len(piece)
            yield
    return crc32


def copy(source: Path, target: Path, reserve_bytes: int = 0) -> Iterator[None]:
    """Copy a file; the target appears when the copy is complete, and leaves the reserve [B] free.

    Raises
    ------
    OSError, and TcError BUSY if the target has appeared in the meantime.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    check_room(target.parent, reserve_bytes, source.stat().st_size, new_file=True)
    unfinished = target.with_name(COPYING)
    try:
        with source.open("rb") as reader, unfinished.open("wb") as writer:
            yield from _pour(reader, writer, source.stat().st_size, target.parent, reserve_bytes)
        if target.exists() or target.is_symlink():
            raise TcError(Error.BUSY, 2, text=f"{target.name} exists")
        unfinished.replace(target)
    finally:
        unfinished.unlink(missing_ok=True)


def append(source: Path, target: Path, offset: int, reserve_bytes: int = 0) -> Iterator[None]:
    """Append a source to a target of `offset` bytes, then remove the source; leave the reserve [B].

    Raises
    ------
    OSError; the target then has its old content.
    """
    if not offset:  # nothing to append to
        source.replace(target)
        return
    with source.open("rb") as reader, target.open("r+b") as writer:
        writer.seek(offset)
        try:
            yield from _pour(reader, writer, source.stat().st_size, target.parent, reserve_bytes)
            writer.flush()
        except BaseException:  # GeneratorExit too, when the generator is closed
            writer.truncate(offset)
            raise
    source.unlink()


def _pour(
    reader: BinaryIO, writer: BinaryIO, length: int, folder: Path, reserve_bytes: int
) -> Iterator[None]:
    """Copy `length` bytes, or fewer if the reader ends; bytes that a log gains are left out."""
    while length and (piece := reader.read(min(PIECE_BYTES, length))):
        check_room(folder, reserve_bytes, len(piece))
        writer.write(piece)
        length -= len(piece)
        yield
