"""Keys of the authenticated link, from files or systemd credentials."""

from collections.abc import Mapping
from pathlib import Path

from fsw.config import Config
from fsw.config.keys import read_key
from fsw.config.sdls import SdlsConfig, SdlsKeyConfig
from fsw.errors import ConfigError
from fsw.telemetry.link.sdls import Association, Role

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
        key = read_key(path, private=slot.credential is None)
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
