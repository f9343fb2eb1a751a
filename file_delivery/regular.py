"""Opens only regular files: what else lies in a file's place must neither hold up nor fill up.

The open of a named pipe waits for its other end, and a device or a sparse file may have no end.
"""

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO, Literal

PERMISSIONS = 0o666  # less the process's umask
MOST_BYTES = 1 << 28  # of a file that is read whole; what the daemon writes is far smaller


def regular(path: str | Path, flags: int, permissions: int = PERMISSIONS) -> int:
    """Open a regular file without waiting; return its descriptor. Raises OSError for any other."""
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, permissions)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "is not a regular file", str(path))
    return descriptor


def open_regular(path: Path, mode: Literal["rb", "wb", "ab+"]) -> BinaryIO:
    """Open a regular file as `open` does. Raises OSError."""
    return open(path, mode, opener=regular)


def read_regular(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Return the content of a regular file. Raises OSError, also for more than `most_bytes` [B]."""
    with open_regular(path, "rb") as file:
        if os.fstat(file.fileno()).st_size > most_bytes:
            raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
        return file.read(most_bytes)
