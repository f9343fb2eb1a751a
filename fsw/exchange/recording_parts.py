"""A recording in parts: consecutive MCAP files, each readable alone, that are read as one.

`recording_0001.mcap` continues in `recording_0001_0002.mcap` and so on. Every part carries the
configuration, the robot and the identity of its recording. The numbers of recordings never repeat,
because a file of the directory keeps the last number even if recordings are deleted.
"""

from collections.abc import Sequence
from pathlib import Path

from file_delivery.durable import replace_file
from file_delivery.regular import read_regular
from fsw.errors import ConfigError
from fsw.exchange.recording import Contents, contents, first_metadata
from fsw.messages.recording_name import NAME

PART, IDENTITY = "part", "recording"  # a metadata record, and its key that names the recording
LAST_NUMBER = ".last_recording"


def new_first(directory: Path) -> Path:
    """Return the first file of a new recording; its number was never used in this directory.

    Raises
    ------
    OSError when the number cannot be stored.
    """
    kept = directory / LAST_NUMBER
    try:
        last = int(read_regular(kept))
    except (FileNotFoundError, ValueError):
        last = 0
    found = (NAME.fullmatch(path.name) for path in directory.iterdir())
    number = max([last, *(int(match["number"]) for match in found if match)]) + 1
    replace_file(kept, f"{number}\n")
    return directory / f"recording_{number:04d}.mcap"


def identity_of(path: Path) -> str | None:
    """Return the identity of the recording that a file belongs to; None if it has none."""
    return first_metadata(path, PART).get(IDENTITY)


def part_path(first: Path, number: int) -> Path:
    """Return the file of a part of the recording that begins with `first`; parts count from 1."""
    return first if number == 1 else first.with_name(f"{first.stem}_{number:04d}{first.suffix}")


def newest_part(directory: Path) -> tuple[Path, int] | None:
    """Return the newest recording's first file and its number of parts; None if none exists."""
    found = [match for path in directory.glob("*.mcap") if (match := NAME.fullmatch(path.name))]
    if not found:
        return None
    stem = max((match["first"] for match in found), key=lambda name: (len(name), name))
    last = max(int(match["part"] or 1) for match in found if match["first"] == stem)
    return directory / f"{stem}.mcap", last


def parts_of(path: Path) -> list[Path]:
    """Return a recording and the parts that follow it, in order.

    Raises
    ------
    ConfigError when a file with the name of a part belongs to another recording, or cannot be read.
    """
    match = NAME.fullmatch(path.name)
    if match is None:
        return [path]
    first = path.with_name(f"{match['first']}.mcap")
    number = int(match["part"] or 1)
    parts = [path]
    while (path := part_path(first, number := number + 1)).exists():
        if identity_of(path) != identity_of(parts[0]):
            raise ConfigError(
                f"{path}: is not a part of {parts[0].name} but of another recording; move it away"
            )
        parts.append(path)
    return parts


def contents_of(parts: Sequence[Path]) -> Contents:
    """Return the contents of all parts together; of equal names the newest one counts.

    Raises
    ------
    ConfigError when a file cannot be read or is not an MCAP file.
    """
    held = [contents(path) for path in parts]
    return Contents(
        topics=tuple(dict.fromkeys(topic for part in held for topic in part.topics)),
        attachments={name: data for part in held for name, data in part.attachments.items()},
        metadata={name: data for part in held for name, data in part.metadata.items()},
        truncated=any(part.truncated for part in held),
    )
