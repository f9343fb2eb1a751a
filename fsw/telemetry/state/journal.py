"""Lines of JSON that survive a restart, in a file of bounded size and the one before it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


class Journal:
    """Appends to a file; a full disk costs lines, never the service.

    Parameters
    ----------
    limit_bytes : size at which the file becomes `NAME.1` and a new one begins
    """

    def __init__(self, path: Path, limit_bytes: int) -> None:
        self._path, self._limit_bytes = path, limit_bytes
        self._before = path.with_name(f"{path.name}.1")

    @property
    def files(self) -> tuple[Path, Path]:
        """Return the file and the one before it; each may be missing."""
        return self._path, self._before

    def append(self, values: Mapping[str, Any]) -> None:
        """Add one line."""
        try:
            if self._path.exists() and self._path.stat().st_size > self._limit_bytes:
                self._path.replace(self._before)
            with self._path.open("a") as file:
                file.write(json.dumps(values) + "\n")
        except OSError:
            return  # the recorder reports a full disk

    def read(self) -> list[dict[str, Any]]:
        """Return the lines that can be read, oldest first."""
        found = []
        for path in (self._before, self._path):
            try:
                lines = path.read_text(errors="replace").splitlines()
            except OSError:
                continue
            for line in lines:
                try:
                    values = json.loads(line)
                except (ValueError, RecursionError):
                    continue  # cut by a power failure
                if isinstance(values, dict):
                    found.append(values)
        return found
