"""Free space of a disk, of which every growing file leaves a reserve to what must be kept."""

import errno
import os
from pathlib import Path

LEAST_INODES = 8  # left for files that must be replaced


def check_room(
    folder: Path, reserve_bytes: int, size_bytes: int = 0, *, new_file: bool = False
) -> None:
    """Check that `size_bytes` more in a folder leave `reserve_bytes` of its disk free [B].

    Raises
    ------
    OSError ENOSPC when they do not, or when a new file would leave too few inodes; any OSError of
    a folder that cannot be examined.
    """
    disk = os.statvfs(folder)
    free_bytes = disk.f_bavail * disk.f_frsize
    few_inodes = new_file and disk.f_files > 0 and disk.f_favail < LEAST_INODES
    if free_bytes < reserve_bytes + size_bytes or few_inodes:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
