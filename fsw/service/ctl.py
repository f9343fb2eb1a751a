"""`fsw ctl`: send one command to a running daemon and return the reply."""

from collections.abc import Iterable
from typing import Any

from fsw.config import Config
from fsw.errors import ConfigError
from fsw.messages.commands import PLAN_BOUNDS
from fsw.service.control import control

NUMBERS = ("last_s", *PLAN_BOUNDS)


def reply_to(config: Config, name: str, pairs: Iterable[str]) -> dict[str, Any]:
    """Send a command with arguments of the form KEY=VALUE; return the daemon's reply.

    Raises
    ------
    ConfigError for a wrong argument (see `request_of`); PortError when no daemon answers.
    """
    request = request_of(name, pairs)
    return control(config.resolve(config.service.state_directory), request)


def request_of(name: str, pairs: Iterable[str]) -> dict[str, object]:
    """Return the request for a command with arguments of the form KEY=VALUE.

    Raises
    ------
    ConfigError for an argument without "=", or a value that must be a number and is not one.
    """
    request: dict[str, object] = {"command": name}
    for pair in pairs:
        key, separator, value = pair.partition("=")
        if not separator:
            raise ConfigError(f"{pair!r}: arguments are KEY=VALUE")
        request[key] = _number(key, value) if key in NUMBERS else value
    return request


def _number(key: str, value: str) -> float:
    try:
        return float(value)
    except ValueError as error:
        raise ConfigError(f"{key}: {value!r} must be a number") from error
