"""The job of `hil vcan`, and its exit codes besides those of the command.

The numbers are those of timeout(1) and the shell.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

TIMED_OUT = 124
FAILED = 125
NO_COMMAND = 127
SIGNAL_BASE = 128  # plus the number of the signal that ended the command
GRACE_S = 5.0  # from one signal to the next stronger


class VcanError(RuntimeError):
    """The command could not be run; the message says what is missing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One command and what it runs in."""

    argv: Sequence[str]
    cwd: str
    env: Mapping[str, str]
    timeout_s: float | None = None
    realtime: bool = False  # the machine in SCHED_FIFO on one processor, where that is allowed


def exit_status(returncode: int) -> int:
    """Return the shell's exit status of a return code; negative ones are signals."""
    return returncode if returncode >= 0 else SIGNAL_BASE - returncode
