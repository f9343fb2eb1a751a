"""Key files: 32 bytes, mode 0600; a replaced file is read again."""

import hashlib
from pathlib import Path

from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from ground.errors import UsageError

KEY_BYTES = 32


class KeyFile:
    """The key in a file.

    Raises
    ------
    UsageError when the file cannot be read, has another size, or is open to others.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stamp = (0, 0)
        self.refresh()

    def refresh(self) -> bool:
        """Read the file if it was replaced; return whether it was. Raises UsageError."""
        try:
            found = self._path.stat()
            stamp = (found.st_ino, found.st_mtime_ns)
            if stamp == self._stamp:
                return False
            key = self._path.read_bytes()
        except OSError as error:
            raise UsageError(f"{self._path}: {error.strerror}") from error
        if len(key) != KEY_BYTES or found.st_mode & 0o077:
            raise UsageError(f"{self._path}: must hold {KEY_BYTES} bytes and have mode 0600")
        self._stamp = stamp
        self.cipher = AESGCM(key)
        self.fingerprint = hashlib.sha256(key).hexdigest()[:16]
        return True
