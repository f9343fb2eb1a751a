"""Secret keys in files."""

import os
from pathlib import Path

from file_delivery.regular import open_regular
from fsw.errors import ConfigError

KEY_BYTES = 32
OTHERS = 0o077


def read_key(path: Path, *, private: bool = True) -> bytes:
    """Return a key; `private`: other users must not have access to its file.

    Raises
    ------
    ConfigError that names file and fault: missing, wrong length, readable by others.
    """
    try:
        with open_regular(path, "rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            key = file.read(KEY_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path}: key cannot be read: {error.strerror}") from error
    if private and mode & OTHERS:
        raise ConfigError(f"{path}: mode {mode & 0o777:04o}; a key must be closed to others, 0600")
    if len(key) != KEY_BYTES:
        raise ConfigError(f"{path}: must hold {KEY_BYTES} bytes")
    return key
