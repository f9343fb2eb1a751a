"""Writes files that survive a crash and a power cut with their old or new content, never a mix.

The flight software, the bench and the ground side may all import this package.
"""

import os
from contextlib import suppress
from pathlib import Path
from typing import IO

from file_delivery.regular import PERMISSIONS, regular


def replace_file(path: Path, content: bytes | str, permissions: int = PERMISSIONS) -> None:
    """Replace a file; the content is on the disk when this returns. Raises OSError.

    The content is first written to a file of the same name with `.new` appended. After a crash
    that file may remain; the next replacement overwrites it.
    """
    temporary = path.with_name(f"{path.name}.new")
    try:
        write_file(temporary, content, permissions)
        rename_file(temporary, path)
    except OSError:
        with suppress(OSError):  # on a full disk a rest would take space from others
            temporary.unlink()
        raise


def write_file(path: Path, content: bytes | str, permissions: int = PERMISSIONS) -> None:
    """Write a file and wait until its content is on the disk. Raises OSError."""
    data = content.encode() if isinstance(content, str) else content
    descriptor = regular(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, permissions)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
        sync_file(file)


def rename_file(source: Path, target: Path) -> None:
    """Rename a file within a folder and wait until the folder is on the disk. Raises OSError."""
    source.replace(target)
    descriptor = os.open(target.parent, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_file(file: IO[bytes] | IO[str]) -> None:
    """Wait until everything written to an open file is on the disk. Raises OSError."""
    file.flush()
    os.fsync(file.fileno())
