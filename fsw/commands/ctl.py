"""The request that `fsw ctl` sends to a running daemon."""

from __future__ import annotations

from collections.abc import Iterable

from fsw.messages.commands import PLAN_BOUNDS
from fsw.messages.errors import ConfigError

NUMBERS = ("last_s", *PLAN_BOUNDS)


def request_of(name: str, pairs: Iterable[str]) -> dict[str, object]:
    """Return a command with its arguments, given as KEY=VALUE.

    Raises
    ------
    ConfigError for what is no pair, or no number where one is needed.
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
