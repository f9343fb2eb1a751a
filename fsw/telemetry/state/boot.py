"""How often the daemon was started, and why the last run ended."""

from __future__ import annotations

import json
from dataclasses import dataclass

from fsw.telemetry.dictionary.codes import RESET_CAUSE
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
        generations, _ = store.read()
        last = json.loads(generations[0].content) if generations else None
        if last is None:
            boot = cls(1, RESET_CAUSE.value("FIRST_START"))
        elif resume:
            return cls(last["count"], last["cause"])
        else:
            cause = RESET_CAUSE.value("CRASH") if last["running"] else last["next_cause"]
            boot = cls(last["count"] + 1, cause)
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
        try:
            store.write(json.dumps(document).encode())
        except OSError:
            return  # the recorder reports a full disk
