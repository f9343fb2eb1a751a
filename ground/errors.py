"""Errors of the ground programs and their exit codes."""

from collections.abc import Iterable
from difflib import get_close_matches

LINK, USAGE, REJECTED, FAILED, NO_ANSWER = 1, 2, 3, 4, 5


class GroundError(Exception):
    """A fault with an exit code; its message is for the operator."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code


class LinkError(GroundError):
    """The daemon cannot be reached, or what comes from it is no telemetry."""

    def __init__(self, message: str) -> None:
        super().__init__(message, LINK)


class UsageError(GroundError):
    """A command or argument the dictionary does not have."""

    def __init__(self, message: str) -> None:
        super().__init__(message, USAGE)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return words about the known names that are like a wrong one; empty when none is."""
    by_upper = {item.upper(): item for item in known}
    near = get_close_matches(name.upper(), by_upper, n=3)
    near += [item for item in by_upper if name and name.upper() in item and item not in near]
    return f"; did you mean {', '.join(by_upper[item] for item in near)}?" if near else ""
