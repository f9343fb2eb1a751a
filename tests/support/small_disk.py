"""A small disk of its own, for tests of what happens when it is full or cannot be written."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

BALLAST = "ballast"


@contextmanager
def small_disk(folder: Path, size_bytes: int, inodes: int = 1000) -> Iterator[Path]:
    """Mount a small file system on `folder`; skip the test for a user who may not mount one."""
    folder.mkdir(exist_ok=True)
    options = f"size={size_bytes},nr_inodes={inodes}"
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    if subprocess.run(command, capture_output=True, check=False).returncode != 0:
        pytest.skip("this user may not mount a disk")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(folder: Path) -> None:
    """Fill a disk to its last byte."""
    with (folder / BALLAST).open("wb", buffering=0) as file, suppress(OSError):
        size = 1 << 16
        while size:
            if file.write(bytes(size)) < size:
                size //= 2


def use_up_inodes(folder: Path) -> None:
    """Leave no inode for a further file."""
    (folder / BALLAST).mkdir()
    with suppress(OSError):
        for number in range(100_000):
            (folder / BALLAST / str(number)).touch()


def read_only(folder: Path, *, on: bool = True) -> None:
    """Permit no more writes to a disk, or permit them again."""
    words = f"remount,{'ro' if on else 'rw'}"
    subprocess.run(["mount", "-o", words, str(folder)], check=True)
