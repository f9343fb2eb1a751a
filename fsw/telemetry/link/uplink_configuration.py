"""Checks of `fsw check` for the authenticated uplink: its keys and its stored numbers."""

from collections.abc import Mapping

from fsw.config import Config
from fsw.errors import ConfigError
from fsw.telemetry.link.sdls_keys import CREDENTIALS, load_associations
from fsw.telemetry.link.sdls_numbers import NUMBERS_NAME, NumberStore


def check_uplink(config: Config, environment: Mapping[str, str]) -> list[str]:
    """Read keys and stored numbers as the daemon does at its start, without writing.

    Returns
    -------
    One warning per credential that was not read: only a service of systemd has credentials.

    Raises
    ------
    ConfigError that names the fault; a daemon with this fault opens no link.
    """
    sdls = None if config.telemetry is None else config.telemetry.sdls
    if sdls is None:
        return []
    state = config.resolve(config.service.state_directory)
    has_credentials = CREDENTIALS in environment
    readable = tuple(key for key in sdls.keys if key.credential is None or has_credentials)
    try:
        load_associations(config, sdls.model_copy(update={"keys": readable}), environment)
        NumberStore(state / NUMBERS_NAME)
    except ConfigError as error:
        raise ConfigError(f"{config.name}: telemetry.sdls: {error}") from error
    return [
        f"telemetry.sdls.keys.{place}.credential: {key.credential!r} was not read: "
        f"{CREDENTIALS} is not set here"
        for place, key in enumerate(sdls.keys)
        if key not in readable
    ]
