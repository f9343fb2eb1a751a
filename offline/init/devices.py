"""The library of named devices of `fsw init`: those of the codecs, and those in devices.yaml."""

from collections.abc import Mapping
from difflib import get_close_matches
from functools import lru_cache
from importlib.metadata import EntryPoint
from importlib.resources import files
from typing import Any

import yaml

from fsw.drivers.codecs.entries import GROUPS, codec_class, installed, options_of, origin
from fsw.errors import ConfigError


@lru_cache(maxsize=1)
def library() -> dict[str, dict[str, dict[str, Any]]]:
    """Return the data of the devices of all codecs and of devices.yaml, by kind and name."""
    text = (files("offline.init") / "devices.yaml").read_text(encoding="utf-8")
    found: dict[str, dict[str, dict[str, Any]]] = {kind: {} for kind in GROUPS}
    for entry, kind, codec in offered():
        if isinstance(codec, type):
            units: Mapping[str, Mapping[str, Any]] = getattr(codec, "devices", {})
            found[kind] |= {name: {**unit, "driver": entry.name} for name, unit in units.items()}
    for kind, devices in yaml.safe_load(text).items():
        found[kind] = found.get(kind, {}) | devices
    return found


def offered() -> list[tuple[EntryPoint, str, type | ConfigError]]:
    """Return every installed codec: entry point, kind, and its class or why it has none."""
    found: list[tuple[EntryPoint, str, type | ConfigError]] = []
    for kind in GROUPS:
        for entry in installed(kind):
            try:
                found.append((entry, kind, codec_class(kind, entry.name)))
            except ConfigError as error:
                found.append((entry, kind, error))
    return found


def codec_listing() -> str:
    """Return lines for each installed codec: what it reads, its options, and where it is from."""
    lines = []
    for entry, kind, codec in offered():
        lines.append(f"{kind} {entry.name}: {getattr(codec, 'title', codec)}; {origin(entry)}")
        if isinstance(codec, type):
            lines += [f"  {option}" for option in map(str, options_of(codec).values())]
    return "\n".join(lines)


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
