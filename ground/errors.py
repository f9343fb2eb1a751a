"""Errors of the ground programs and their exit codes."""

from collections.abc import Iterable
from difflib import get_close_matches

LINK, USAGE, REJECTED, FAILED, NO_ANSWER = 1, 2, 3, 4, 5


class GroundError(Exception):
    """An error with the exit code of the program; its message is for the operator."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code


class LinkError(GroundError):
    """The daemon cannot be reached, or the received bytes are not telemetry."""

    def __init__(self, message: str) -> None:
        super().__init__(message, LINK)


class UsageError(GroundError):
    """A command, an argument or a local file is wrong."""

    def __init__(self, message: str) -> None:
        super().__init__(message, USAGE)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a hint with the known names similar to a wrong one; empty if there are none."""
    by_upper = {item.upper(): item for item in known}
    near = get_close_matches(name.upper(), by_upper, n=3)
    near += [item for item in by_upper if name and name.upper() in item and item not in near]
    return f"; did you mean {', '.join(by_upper[item] for item in near)}?" if near else ""
