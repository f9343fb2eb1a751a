"""Command history of the ground: every telecommand that was sent, by whom, and its outcome."""

import getpass
import json
import os
import socket
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ground.errors import UsageError
from ground.state_folder import made
from ground.verification import Verification

NAME = "commands.jsonl"
LIMIT_BYTES = 4 << 20  # a larger file is renamed to NAME.1


class CommandHistory:
    """The history as lines of JSON in the ground's state folder.

    Parameters
    ----------
    folder : state folder of the ground
    target : address of the daemon that receives the commands, HOST:PORT
    """

    def __init__(self, folder: Path, target: str = "") -> None:
        self._path = folder.expanduser() / NAME
        self._target = target

    def add(self, command: str, arguments: str, verification: Verification, via: str) -> None:
        """Add one command. Raises UsageError when the folder cannot be written."""
        last = verification.reports[-1].values if verification.reports else {}
        line = {
            "utc": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "who": f"{_user()}@{socket.gethostname()}",
            "via": via,
            "target": self._target,
            "command": command,
            "arguments": arguments,
            "request": list(verification.request),
            "outcome": str(verification.outcome),
            "error": str(last.get("error", "")),
        }
        try:
            made(self._path.parent)
            if self._path.exists() and self._path.stat().st_size > LIMIT_BYTES:
                self._path.replace(self._path.with_name(f"{NAME}.1"))
            with os.fdopen(
                os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600), "a"
            ) as file:
                file.write(json.dumps(line) + "\n")
        except OSError as error:
            raise UsageError(f"{self._path}: {error.strerror or error}") from error

    def read(self, count: int) -> list[dict[str, Any]]:
        """Return the newest `count` commands, the oldest first; skip damaged lines."""
        found = []
        for path in (self._path.with_name(f"{NAME}.1"), self._path):
            if not path.exists():
                continue
            for line in path.read_text(errors="replace").splitlines():
                try:
                    values = json.loads(line)
                except (ValueError, RecursionError):
                    continue
                if isinstance(values, dict):
                    found.append(values)
        return found[-count:]


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"uid {os.getuid()}"
