"""Small disks that can be spoiled: ext4 images on loop devices."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hil.world.scenario import ScenarioError

INODES = 256
BALLAST = "ballast"
ERRORS = Path("/sys/fs/ext4")


@contextmanager
def small_disk(folder: Path, size_bytes: int) -> Iterator[Path]:
    """Mount a new disk of a size below a folder. Raises ScenarioError if this user may not."""
    image, disk = folder / "disk.img", folder / "disk"
    disk.mkdir()
    with image.open("wb") as file:
        file.truncate(size_bytes)
    options = ["-q", "-F", "-O", "^has_journal", "-m", "0", "-b", "1024", "-N", str(INODES)]
    _run("mkfs.ext4", *options, str(image))
    _run("mount", "-o", "loop,errors=remount-ro", str(image), str(disk))
    try:
        yield disk
    finally:
        _run("umount", "-l", str(disk))
        image.unlink()


def _run(*command: str) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise ScenarioError(f"--lane disk: needs {command[0]}") from error
    if done.returncode != 0:
        raise ScenarioError(f"--lane disk: {' '.join(command[:2])}: {done.stderr.strip()}")


def fill(disk: Path) -> None:
    """Fill a disk to its last block."""
    with (disk / BALLAST).open("wb", buffering=0) as file:
        size = 1 << 18
        while size >= 256:
            try:
                whole = file.write(bytes(size)) == size
            except OSError:
                whole = False
            size = size if whole else size // 2


def use_up_inodes(disk: Path) -> None:
    """Leave no inode for a further file."""
    folder = disk / BALLAST
    with suppress(OSError):
        folder.mkdir()
        for number in range(INODES):
            (folder / str(number)).touch()


def read_only(disk: Path) -> None:
    """Let the file system find an error, so that the kernel permits no more writes to it."""
    found = subprocess.run(
        ["findmnt", "-no", "SOURCE", str(disk)], capture_output=True, text=True, check=True
    )
    (ERRORS / Path(found.stdout.strip()).name / "trigger_fs_error").write_text("disk lane")


def remove(disk: Path) -> None:
    """Remove everything on a disk, as somebody who cleans up does."""
    for path in disk.iterdir():
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def empty(disk: Path) -> None:
    """Take the ballast away again."""
    ballast = disk / BALLAST
    if ballast.is_dir():
        shutil.rmtree(ballast)
    else:
        with suppress(OSError):
            ballast.unlink(missing_ok=True)


def free_bytes(disk: Path) -> int:
    """Return the free space of a disk."""
    room = os.statvfs(disk)
    return room.f_bavail * room.f_frsize
