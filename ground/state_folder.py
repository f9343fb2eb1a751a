"""The ground's own folder: numbers, history and unfinished transfers."""

from pathlib import Path

from ground.errors import UsageError

CLOSED = 0o700  # permissions: names of commands and numbers of keys are nobody else's


def made(folder: Path) -> Path:
    """Return the folder; make it if it is missing, closed to other users. Raises UsageError."""
    try:
        folder.mkdir(CLOSED, parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: {error.strerror}") from error
    return folder
