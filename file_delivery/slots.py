"""A small document in a file of two copies, replaced in place: that needs no free block or inode.

Both copies have room for half of the file. Each is one line of JSON with a sequence number and a
CRC-32, and zeros behind it. A write goes to the copies in turn: the first one is on the disk before
the other is touched, so a crash or power cut leaves at least one of them whole. If one copy decays,
the other holds the same document.
"""

import json
import os
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

from file_delivery.durable import replace_file
from file_delivery.regular import read_regular

ROOM_BYTES = 4096  # of a copy at first: one block
PERMISSIONS = 0o600


class SlotError(ValueError):
    """No copy of a document is whole."""


class SlotFile:
    """A document of plain JSON values; one process writes it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._sequence: int | None = None  # of the newest copies; None: not read yet

    def read(self) -> Any:  # noqa: ANN401
        """Return the newest document. Raises OSError, or SlotError when both copies are damaged."""
        data = read_regular(self.path)
        room = len(data) // 2
        found, faults = [], []
        for copy in (data[:room], data[room:]):
            try:
                found.append(_parse(copy))
            except (ValueError, KeyError, TypeError, RecursionError) as error:
                faults.append(str(error) or type(error).__name__)
        if not found:
            raise SlotError("; ".join(faults))
        self._sequence, document = max(found, key=lambda item: item[0])
        return document

    def write(self, document: object) -> None:
        """Replace the document; it is on the disk when this returns. Raises OSError.

        A missing file is created again, with its folder. A document without room gets a new file;
        these two cases need free space.
        """
        sequence = self._newest() + 1
        line = _line(sequence, document)
        try:
            descriptor = os.open(self.path, os.O_RDWR | os.O_CLOEXEC)
        except FileNotFoundError:
            self._create(line)
        else:
            try:
                room = os.fstat(descriptor).st_size // 2
                if room < len(line):
                    self._create(line)
                else:
                    _write_copies(descriptor, sequence % 2, line.ljust(room, b"\0"))
            finally:
                os.close(descriptor)
        self._sequence = sequence

    def _newest(self) -> int:
        """Return the sequence number of the newest copy; 0 without one. Raises OSError."""
        if self._sequence is None:
            with suppress(FileNotFoundError, SlotError):
                self.read()
        return self._sequence or 0

    def _create(self, line: bytes) -> None:
        room = ROOM_BYTES
        while room < len(line):
            room *= 2
        self.path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(self.path, 2 * line.ljust(room, b"\0"), PERMISSIONS)


def _write_copies(descriptor: int, first: int, copy: bytes) -> None:
    """Write both copies; the second may reach the disk later. Raises OSError."""
    _write_at(descriptor, first * len(copy), copy)
    os.fdatasync(descriptor)
    with suppress(OSError):  # the first copy is enough
        _write_at(descriptor, (1 - first) * len(copy), copy)


def _write_at(descriptor: int, offset: int, data: bytes) -> None:
    while data:
        count = os.pwrite(descriptor, data, offset)
        data, offset = data[count:], offset + count


def _line(sequence: int, document: object) -> bytes:
    values = {"sequence": sequence, "document": document}
    return json.dumps(values | {"crc32": _crc32(values)}, sort_keys=True).encode() + b"\n"


def _crc32(values: object) -> int:
    return zlib.crc32(json.dumps(values, sort_keys=True).encode())


def _parse(copy: bytes) -> tuple[int, Any]:
    """Return sequence number and document of a copy. Raises ValueError, KeyError, TypeError."""
    values = json.loads(copy.rstrip(b"\0"))
    found = {"sequence": int(values["sequence"]), "document": values["document"]}
    if values["crc32"] != _crc32(found):
        raise ValueError("its CRC is wrong")
    return found["sequence"], found["document"]
