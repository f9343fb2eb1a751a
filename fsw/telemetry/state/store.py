"""Files that a power cut leaves old or new, never a mixture: numbered generations with a CRC.

A generation is written under a temporary name, synchronised to the disk, and only then renamed.
Readers use the highest generation with a correct CRC. Earlier generations stay for a rollback.
Layout, big-endian: magic (4), format version u16, generation u32, length u32, CRC-32 of the content
u32; content.
"""

import re
import struct
import zlib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from file_delivery.durable import rename_file, write_file
from file_delivery.regular import read_regular

MAGIC = b"FSWG"
FORMAT_VERSION = 1
KEPT = 3  # number of generations
TEMPORARY = "new.tmp"
_HEAD = struct.Struct(">4sHIII")
_NAME = re.compile(r"(\d{8})\.gen$")


@dataclass(frozen=True, slots=True)
class Generation:
    """One stored generation: its number and its content."""

    number: int
    content: bytes

    @property
    def crc32(self) -> int:
        """Return the CRC-32 of the content."""
        return zlib.crc32(self.content)


class GenerationStore:
    """Generations of one document, in a directory used for nothing else."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    def read(self) -> tuple[list[Generation], int]:
        """Return the valid generations, newest first, and the number of damaged files."""
        found, damaged = [], 0
        for number, path in self._files():
            generation = _parse(path, number)
            if generation is None:
                damaged += 1
            else:
                found.append(generation)
        return found, damaged

    def prepare(self, content: bytes) -> int:
        """Write the next generation under a temporary name; return its number.

        Raises
        ------
        OSError; then nothing has changed.
        """
        self.directory.mkdir(parents=True, exist_ok=True)
        number = max((n for n, _ in self._files()), default=0) + 1
        head = _HEAD.pack(MAGIC, FORMAT_VERSION, number, len(content), zlib.crc32(content))
        write_file(self.directory / TEMPORARY, head + content)
        return number

    def commit(self, number: int) -> None:
        """Make the prepared generation the newest; it survives a power cut. Raises OSError."""
        rename_file(self.directory / TEMPORARY, self.directory / f"{number:08d}.gen")
        for _, path in self._files()[KEPT:]:
            path.unlink(missing_ok=True)

    def discard(self) -> None:
        """Discard the prepared generation."""
        with suppress(OSError):  # the next one overwrites it
            (self.directory / TEMPORARY).unlink()

    def write(self, content: bytes) -> int:
        """Prepare and commit a generation; return its number. Raises OSError."""
        number = self.prepare(content)
        self.commit(number)
        return number

    def _files(self) -> list[tuple[int, Path]]:
        """Return number and path of each generation, newest first."""
        if not self.directory.is_dir():
            return []
        named = [(_NAME.match(path.name), path) for path in self.directory.iterdir()]
        return sorted(((int(m[1]), path) for m, path in named if m), reverse=True)


def _parse(path: Path, number: int) -> Generation | None:
    try:
        data = read_regular(path)
    except OSError:
        return None
    if len(data) < _HEAD.size:
        return None
    magic, version, stated, length, crc = _HEAD.unpack_from(data)
    content = data[_HEAD.size :]
    good = magic == MAGIC and version == FORMAT_VERSION and stated == number
    if not good or len(content) != length or zlib.crc32(content) != crc:
        return None
    return Generation(number, content)
