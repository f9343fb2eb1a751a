"""Resolves file names from the other end, confined to one directory."""

from pathlib import Path, PurePosixPath

from file_delivery.errors import DeliveryError

UNKNOWN = "FILE_NOT_FOUND"
HIDDEN = "."  # names that begin with this are reserved for the daemon
MAX_CHARACTERS = 89  # of a name: a telecommand holds a path of 95 with `files/` before it


def confined(directory: Path, name: str) -> Path:
    """Return the path of a name below the directory; neither `..` nor a link leads out of it.

    A telecommand must be able to name the file: printable ASCII of at most MAX_CHARACTERS.

    Raises
    ------
    DeliveryError FILE_NOT_FOUND for a name that is not allowed, as for a missing file.
    """
    parts = PurePosixPath(name).parts
    if not parts or parts[0] == "/" or any(part.startswith(HIDDEN) for part in parts):
        raise DeliveryError(UNKNOWN, f"{name!r} is not a name below the file directory")
    if len(name) > MAX_CHARACTERS or not (name.isascii() and name.isprintable()):
        text = f"at most {MAX_CHARACTERS} printable ASCII characters, not {name!a}"
        raise DeliveryError(UNKNOWN, text)
    try:
        path = (directory / PurePosixPath(name)).resolve()
    except (OSError, ValueError, RuntimeError) as error:  # a NUL, a loop of links
        raise DeliveryError(UNKNOWN, f"{name!r}: {error}") from error
    if not path.is_relative_to(directory.resolve()):
        raise DeliveryError(UNKNOWN, f"{name!r} is not below the file directory")
    return path
