"""Checks of `fsw check` for the authenticated uplink: its keys and its stored numbers."""

from collections.abc import Mapping

from fsw.config import Config
from fsw.messages.errors import ConfigError
from fsw.telemetry.link.sdls_keys import CREDENTIALS, load_associations
from fsw.telemetry.link.sdls_numbers import NUMBERS_NAME, NumberStore


def check_uplink(config: Config, environment: Mapping[str, str]) -> list[str]:
    """Read keys and numbers as the daemon will at its start; nothing is written.

    Returns
    -------
    The warnings: credentials exist only in a service that systemd has started.

    Raises
    ------
    ConfigError naming the fault; a daemon started with it opens no link.
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
