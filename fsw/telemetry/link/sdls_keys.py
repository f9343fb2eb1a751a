"""Keys of the authenticated link, from files or systemd credentials."""

import os
from collections.abc import Mapping
from pathlib import Path

from file_delivery.regular import open_regular
from fsw.config import Config
from fsw.config.sdls import SdlsConfig, SdlsKeyConfig
from fsw.errors import ConfigError
from fsw.telemetry.link.sdls import KEY_BYTES, Association, Role

OTHERS = 0o077
CREDENTIALS = "CREDENTIALS_DIRECTORY"


def load_associations(
    config: Config, sdls: SdlsConfig, environment: Mapping[str, str]
) -> tuple[Association, ...]:
    """Read the keys of all slots.

    Raises
    ------
    ConfigError that names file and fault: missing, wrong length, readable by others, used twice.
    """
    found: list[Association] = []
    for slot in sdls.keys:
        path = _path(config, slot, environment)
        key = _read(path, private=slot.credential is None)
        if any(other.key == key for other in found):
            raise ConfigError(f"{path}: the key of another slot; each must have its own")
        found.append(Association(spi=slot.spi, key=key, role=Role(slot.role)))
    return tuple(found)


def _path(config: Config, slot: SdlsKeyConfig, environment: Mapping[str, str]) -> Path:
    if slot.file is not None:
        return config.resolve(slot.file)
    folder = environment.get(CREDENTIALS)
    if folder is None:
        raise ConfigError(f"SPI {slot.spi}: credential {slot.credential!r}: {CREDENTIALS} not set")
    return Path(folder) / str(slot.credential)


def _read(path: Path, *, private: bool) -> bytes:
    """Return a key; `private`: other users must not have access to its file. Raises ConfigError."""
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
