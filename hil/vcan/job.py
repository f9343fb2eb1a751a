"""The job of `hil vcan`, and the exit codes in addition to the command's.

The numbers are as in timeout(1) and the shell.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

TIMED_OUT = 124
FAILED = 125
NO_COMMAND = 127
SIGNAL_BASE = 128  # plus the number of the signal that ended the command
GRACE_S = 5.0  # from one signal to the next stronger signal


class VcanError(RuntimeError):
    """The command could not be run; the message says what is missing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One command with folder, environment and time limit [s] (None: no limit)."""

    argv: Sequence[str]
    cwd: str
    env: Mapping[str, str]
    timeout_s: float | None = None
    realtime: bool = False  # run the guest in SCHED_FIFO on one processor, if allowed


def exit_status(returncode: int) -> int:
    """Return the shell's exit status of a return code; a negative code is a signal."""
    return returncode if returncode >= 0 else SIGNAL_BASE - returncode
