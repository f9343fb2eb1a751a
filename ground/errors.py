"""What can go wrong on the ground, and the exit code it gives."""

from __future__ import annotations

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
