"""The status file: the newest status as JSON, for observers of the daemon."""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from file_delivery.regular import open_regular, read_regular
from fsw.errors import WRONG_CONTENT
from fsw.exchange.status import STATUS_NAME


class StatusFile:
    """Replaces the file as a whole; on a bad disk the old one stays."""

    def __init__(self, directory: Path) -> None:
        self._path = directory / STATUS_NAME

    def event_counts(self) -> Mapping[str, int]:
        """Return the event counts in the file of a crashed service; empty if it is unreadable."""
        try:
            status = json.loads(read_regular(self._path))
            return {str(code): int(n) for code, n in status.get("event_counts", {}).items()}
        except (OSError, *WRONG_CONTENT):
            return {}

    def write(self, values: Mapping[str, Any]) -> None:
        """Replace the file, if the disk permits it."""
        temporary = self._path.with_suffix(".tmp")
        try:
            with open_regular(temporary, "wb") as file:
                file.write(json.dumps(values).encode())
            temporary.replace(self._path)
        except OSError:
            with suppress(OSError):  # a rest would take space from others
                temporary.unlink()
