"""Overlay files: YAML files with some keys, which replace those keys of a configuration.

An overlay has the sections and keys of a configuration. A list of sections with `name` (such as
buses and joints) contains only the changed ones; any other list replaces the whole list.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from fsw.config.text import CONFIGURATION, TextError, must_be, no_sections, read_yaml
from fsw.config.whole import Config, parse
from fsw.errors import ConfigError

ONE_OF_TWO = {"q_BS_xyzw": "rpy_BS_rad", "rpy_BS_rad": "q_BS_xyzw"}  # one replaces the other


def with_overlays(config: Config, overlays: Sequence[Path]) -> Config:
    """Return the configuration with overlay files applied in order; its `source` includes them.

    Raises
    ------
    ConfigError with one line per fault, which names file, key, value and bound.
    """
    if not overlays:
        return config
    data: object = read_yaml(config.source, aliases=True)
    for path in overlays:
        data = merged(data, _read(path), str(path))
    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True).encode()
    return parse(text, config.resolve(Path()), *config.files, *map(str, overlays))


def _read(path: Path) -> dict[Any, Any]:
    try:
        source = path.read_bytes()
        must_be(source, str(path), CONFIGURATION)
        data = read_yaml(source, aliases=True)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except TextError as error:
        raise ConfigError(f"{path}: {error}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: {no_sections(data)}")
    return data


def merged(below: object, above: object, file: str, key: str = "") -> object:
    """Return values `below` with those of an overlay `above` applied.

    `file` names the overlay in messages, `key` is the prefix of its keys.

    Raises
    ------
    ConfigError for a named section that is not in `below`.
    """
    if isinstance(below, dict) and isinstance(above, dict):
        kept = {name: value for name, value in below.items() if ONE_OF_TWO.get(name) not in above}
        return kept | {
            name: merged(kept.get(name), value, file, f"{key}{name}.")
            for name, value in above.items()
        }
    named, changes = _by_name(below), _by_name(above)
    if named is None or changes is None:
        return above
    strange = [name for name in changes if name not in named]
    if strange:
        raise ConfigError(f"{file}: {key}name: {strange[0]!r} must be one of {', '.join(named)}")
    return [merged(item, changes.get(name, {}), file, key) for name, item in named.items()]


def _by_name(values: object) -> dict[str, object] | None:
    """Return the sections of a list by name; None: this is not such a list."""
    if not isinstance(values, list):
        return None
    named: dict[str, object] = {
        str(item["name"]): item for item in values if isinstance(item, dict) and "name" in item
    }
    return named if len(named) == len(values) else None
