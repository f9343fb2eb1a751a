"""Every key of a scenario of the bench: its values, default and meaning, from models and code."""

import json
import re
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from fsw.config.reference import REQUIRED, Key
from fsw.errors import ConfigError
from hil.world import scenario
from hil.world.environment.config import EnvironmentSection
from hil.world.sensor_config import SensorConfig


def sections() -> dict[str, list[Key]]:
    """Return the keys of the file, and those of the sections that may be files of their own."""
    parts = {
        "": scenario.Document.model_json_schema(),
        "sensors": TypeAdapter(SensorConfig).json_schema(),
        "flight": scenario.FlightSection.model_json_schema(),
        "environment": EnvironmentSection.model_json_schema(),
    }
    folder = Path(scenario.__file__).parent
    code = "\n".join(path.read_text(encoding="utf-8") for path in sorted(folder.rglob("*.py")))
    return {
        name: list(_keys(f"{name}." if name else "", whole, whole, code, {}))
        for name, whole in parts.items()
    }


def keys_of(part: str) -> list[Key]:
    """Return the key that `part` names, or all keys of the section that it names; "": all keys.

    Raises
    ------
    ConfigError if no key or section has this name.
    """
    every = [key for own in sections().values() for key in own]
    wanted = part.replace("[]", "").split(".") if part else []
    paths = [key.name.replace("[]", "").replace(".NAME", "").split(".") for key in every]
    found = [key for key, path in zip(every, paths, strict=True) if path[: len(wanted)] == wanted]
    if not found:
        heads = {".".join(path[: k + 1]) for path in paths for k in range(len(path))}
        close = get_close_matches(part, sorted(heads), n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise ConfigError(f"{part}: must be a key{hint}")
    return found


def _keys(
    prefix: str,
    section: Mapping[str, Any],
    whole: Mapping[str, Any],
    code: str,
    shown: dict[str, str],
) -> Iterator[Key]:
    """Yield each key of a section and of those in it, with the code's own comment.

    `shown` : where each section stands that was yielded; it is yielded once
    """
    block = re.search(rf"^class {section['title']}\b.*?(?=^\S|\Z)", code, re.MULTILINE | re.DOTALL)
    for key, value in section["properties"].items():
        found = re.search(rf"^    {key}: [^#\n]*# (.*)$", block[0] if block else "", re.MULTILINE)
        required = key in section.get("required", ())
        given = REQUIRED if required else json.dumps(value.get("default"))
        names = list(dict.fromkeys(re.findall(r'"#/\$defs/(\w+)"', json.dumps(value))))
        kind = next((f"as {shown[name]}" for name in names if name in shown), "section")
        yield Key(f"{prefix}{key}", _values(value, kind), given, found[1] if found else "")
        many = {"array": "[]", "object": ".NAME"}.get(value.get("type", ""), "")
        for name in (name for name in names if name not in shown):  # several: one of these
            shown[name] = f"{prefix}{key}"
            yield from _keys(f"{prefix}{key}{many}.", whole["$defs"][name], whole, code, shown)


def _values(value: Mapping[str, Any], section: str) -> str:
    """Return the allowed values of a key in words; `section` stands for those of a section."""
    if "$ref" in value:
        return section
    if options := value.get("anyOf", value.get("oneOf")):
        return " or ".join(dict.fromkeys(_values(option, section) for option in options))
    if "enum" in value or "const" in value:
        return ", ".join(json.dumps(v) for v in value.get("enum", [value.get("const")]))
    if "prefixItems" in value:
        return f"{len(value['prefixItems'])} of: {_values(value['prefixItems'][0], section)}"
    kind = value.get("type", "any")
    inner = value.get("items", value.get("additionalProperties"))
    if kind in {"array", "object"} and isinstance(inner, dict):
        return f"{'list of' if kind == 'array' else 'by name:'} {_values(inner, section)}"
    words = {
        "minimum": ">=",
        "exclusiveMinimum": ">",
        "maximum": "<=",
        "exclusiveMaximum": "<",
        "minLength": "length >=",
        "pattern": "matching",
    }
    bounds = [f"{sign} {value[key]}" for key, sign in words.items() if key in value]
    return " ".join([str(kind), *bounds])
