"""How often the daemon was started, and why the last run ended."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from fsw.telemetry.dictionary.codes import RESET_CAUSE
from fsw.telemetry.link.telecommands import TcError
from fsw.telemetry.state.documents import keep_document, read_document
from fsw.telemetry.state.store import GenerationStore

# texts of the dictionary's reset_cause, in the order of its numbers
CAUSES = ("first start", "stopped before", "restart commanded", "the last run crashed")


@dataclass(frozen=True, slots=True)
class Boot:
    """Number of this run on its state directory, and the reason for its start."""

    count: int
    cause: int  # number of the dictionary's reset_cause

    @classmethod
    def begin(cls, store: GenerationStore, *, resume: bool) -> Boot:
        """Count and store this start. With `resume` the loop never stopped: return the same run.

        If the state directory cannot be written, the start is counted but not stored.
        """
        last, _ = read_document(store, _parse)
        if last is None:
            boot = cls(1, RESET_CAUSE.value("FIRST_START"))
        elif resume:
            return last.boot
        else:
            cause = RESET_CAUSE.value("CRASH") if last.running else last.next_cause
            boot = cls(last.boot.count + 1, cause)
        boot.keep(store, running=True, commanded=False)
        return boot

    def text(self) -> str:
        """Return the text of the event STARTED."""
        return f"run {self.count}: {CAUSES[self.cause]}"

    def keep(self, store: GenerationStore, *, running: bool, commanded: bool) -> None:
        """Store whether the daemon runs or ended in order; `commanded`: it ended by RESTART."""
        document = {
            "count": self.count,
            "cause": self.cause,
            "running": running,
            "next_cause": RESET_CAUSE.value("COMMANDED" if commanded else "STOPPED"),
        }
        with suppress(TcError):  # the recorder reports a full disk
            keep_document(store, document)


@dataclass(frozen=True, slots=True)
class _Stored:
    """The last run as it was stored, and the cause of the start that follows its end."""

    boot: Boot
    running: bool
    next_cause: int


def _parse(document: Any) -> _Stored:  # noqa: ANN401
    count, causes = int(document["count"]), (document["cause"], document["next_cause"])
    if count < 1 or any(cause not in range(len(CAUSES)) for cause in causes):
        raise ValueError("a count from 1, and causes of the dictionary")
    return _Stored(Boot(count, causes[0]), document["running"] is True, causes[1])
