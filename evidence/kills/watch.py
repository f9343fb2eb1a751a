"""Observe a daemon from outside: its status file, its events, its processes."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hil.run.live import LiveError, read_status

POLL_S = 0.002
PATIENCE_S = 180.0


def wait_for(condition: Callable[[], bool], what: str, patience_s: float = PATIENCE_S) -> None:
    """Wait until a condition holds. Raises LiveError after `patience_s`."""
    deadline_s = time.monotonic() + patience_s
    while not condition():
        if time.monotonic() > deadline_s:
            raise LiveError(f"not within {patience_s} s: {what}")
        time.sleep(POLL_S)


class Observer:
    """Reads the status and the events in the state directory of a daemon."""

    def __init__(self, state: Path) -> None:
        self._state = state
        self._events_at = 0
        self.status: dict[str, Any] = {}

    def status_since(self, t_ns: int) -> bool:
        """Return whether a status with an estimate is newer than `t_ns`; store it in `status`."""
        status = read_status(self._state / "status.json")
        if status is None or int(status["t_ns"]) <= t_ns or status.get("estimate") is None:
            return False
        self.status = status
        return True

    def events(self) -> list[dict[str, Any]]:
        """Return the events that were written since the last call."""
        path = self._state / "events.jsonl"
        if not path.exists():
            return []
        with path.open("rb") as file:
            file.seek(self._events_at)
            data = file.read()
        whole = data[: data.rfind(b"\n") + 1]
        self._events_at += len(whole)
        return [json.loads(line) for line in whole.splitlines()]


def alive(pid: int) -> bool:
    """Return whether a process runs; a zombie does not run."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except (FileNotFoundError, ProcessLookupError):
        return False
    return stat.rsplit(")", 1)[1].split()[0] not in ("Z", "X")
