"""The status file: the newest status as JSON, for observers of the daemon."""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from fsw.exchange.status import STATUS_NAME


class StatusFile:
    """Replaces the file as a whole; on a bad disk the old one stays."""

    def __init__(self, directory: Path) -> None:
        self._path = directory / STATUS_NAME

    def event_counts(self) -> Mapping[str, int]:
        """Return the event counts in the file of a crashed service; empty if it is unreadable."""
        try:
            status = json.loads(self._path.read_text())
        except (OSError, ValueError):
            return {}
        return {str(code): int(n) for code, n in status.get("event_counts", {}).items()}

    def write(self, values: Mapping[str, Any]) -> None:
        """Replace the file, if the disk permits it."""
        temporary = self._path.with_suffix(".tmp")
        try:
            temporary.write_text(json.dumps(values))
            temporary.replace(self._path)
        except OSError:
            with suppress(OSError):  # a rest would take space from others
                temporary.unlink()
