"""The library of named devices of `fsw init`, in devices.yaml."""

from collections.abc import Mapping
from difflib import get_close_matches
from functools import lru_cache
from importlib.resources import files
from typing import Any

import yaml

from fsw.errors import ConfigError


@lru_cache(maxsize=1)
def library() -> dict[str, dict[str, dict[str, Any]]]:
    """Return the data of the devices in devices.yaml, by kind and name."""
    text = (files("fsw.commands") / "devices.yaml").read_text(encoding="utf-8")
    found: dict[str, dict[str, dict[str, Any]]] = yaml.safe_load(text)
    return found


def listing() -> str:
    """Return one line for each device of the library, with the source of its data."""
    return "\n".join(
        f"{kind} {name}: {device['title']}; {trust(device)}"
        for kind, devices in library().items()
        for name, device in devices.items()
    )


def trust(device: Mapping[str, Any]) -> str:
    """Return the source of a device's figures, and whether somebody has verified them."""
    return f"{'' if device['verified'] else 'NOT VERIFIED: '}{device['source']}"


def device(kind: str, name: str) -> dict[str, Any]:
    """Return the figures of a named device; raise ConfigError if there is no such device."""
    devices = library()[kind]
    if name not in devices:
        close = get_close_matches(name, devices, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise ConfigError(f"{kind} {name!r}: {hint}known are {', '.join(devices)}")
    return devices[name]
