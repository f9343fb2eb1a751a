"""Lines of JSON that survive a restart, in a file of bounded size and its predecessor."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from file_delivery.regular import open_regular, read_regular
from file_delivery.room import check_room


class Journal:
    """Appends lines to a file; on a full disk lines are lost and counted, the service continues.

    Parameters
    ----------
    limit_bytes : above this size the file is renamed to `NAME.1` and a new file begins [B]
    reserve_bytes : free space of the disk that lines leave alone [B]
    """

    def __init__(self, path: Path, limit_bytes: int, reserve_bytes: int = 0) -> None:
        self._path, self._limit_bytes, self._reserve_bytes = path, limit_bytes, reserve_bytes
        self.lost = 0  # lines that could not be written
        self._before = path.with_name(f"{path.name}.1")

    @property
    def files(self) -> tuple[Path, Path]:
        """Return the paths of the file and its predecessor; each file may be missing."""
        return self._path, self._before

    def append(self, values: Mapping[str, Any]) -> None:
        """Append one line; a line that cannot be written is lost.

        A line that was cut by a full disk or a power failure is ended first.
        """
        try:
            check_room(self._path.parent, self._reserve_bytes)
            if self._path.exists() and self._path.stat().st_size > self._limit_bytes:
                self._path.replace(self._before)
            with open_regular(self._path, "ab+") as file:
                whole = file.tell() == 0 or _last_byte(file) == b"\n"
                file.write(b"" if whole else b"\n")
                file.write(json.dumps(values).encode() + b"\n")
        except OSError:
            self.lost += 1

    def read(self) -> list[dict[str, Any]]:
        """Return the values of all readable lines, oldest first."""
        found = []
        for path in (self._before, self._path):
            try:
                lines = read_regular(path).decode(errors="replace").splitlines()
            except OSError:
                continue
            for line in lines:
                try:
                    values = json.loads(line)
                except (ValueError, RecursionError):
                    continue  # a power failure cut the line
                if isinstance(values, dict):
                    found.append(values)
        return found


def _last_byte(file: IO[bytes]) -> bytes:
    file.seek(-1, os.SEEK_END)
    return file.read(1)
