"""Every key of the configuration: its values, default and meaning, as the sections declare them.

The meaning of a key is the text below its declaration. It is read from the source code when it is
asked for, so that no start of the daemon pays for it.
"""

import ast
import inspect
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from fsw.config.joints import linear
from fsw.config.text import model_in
from fsw.config.whole import Config
from fsw.errors import ConfigError

REQUIRED = "required"
_LINK = re.compile(r"\[([^]]+)\]\([^)]+\)")


@dataclass(frozen=True, slots=True)
class Key:
    """One key: its full name, the allowed values, the default, and the meaning (Markdown)."""

    name: str
    values: str
    default: str
    meaning: str

    def row(self) -> str:
        """Return the key as a row of a table in Markdown."""
        cells = (f"`{self.name}`", self.values, self.default, self.meaning.replace("|", "\\|"))
        return f"| {' | '.join(cells)} |"

    def words(self) -> str:
        """Return the key as lines for a terminal."""
        default = self.default if self.default == REQUIRED else f"default {self.default}"
        return f"{self.name}: {self.values}; {default}\n    {plain(self.meaning)}"


def keys(model: type[BaseModel] = Config, prefix: str = "") -> Iterator[Key]:
    """Yield every key that holds a value, in the order of the sections."""
    properties = model.model_json_schema()["properties"]
    texts = meanings(model)
    for name, field in model.model_fields.items():
        inner, kind = model_in(field.annotation), str(field.annotation)
        if inner is not None:
            many = "[]" if kind.startswith("tuple") else ""
            many = ".NAME" if kind.startswith("dict") else many
            yield from keys(inner, f"{prefix}{name}{many}.")
            continue
        default = REQUIRED if field.default is PydanticUndefined else _yaml(field.default)
        yield Key(f"{prefix}{name}", _values(properties[name]), default, texts.get(name, ""))


def keys_of(part: str) -> list[Key]:
    """Return the key that `part` names, or all keys of the section that it names.

    Raises
    ------
    ConfigError if no key or section has this name.
    """
    wanted = part.replace("[]", "").split(".")
    found = [
        key
        for key in keys()
        if key.name.replace("[]", "").replace(".NAME", "").split(".")[: len(wanted)] == wanted
    ]
    if not found:
        raise ConfigError(f"{part}: must be one of {', '.join(Config.model_fields)}, or a key")
    return found


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a configuration; it lacks conditions between sections."""
    schema = Config.model_json_schema()
    for model in _models(Config):
        section = schema["$defs"].get(model.__name__, schema)
        for name, meaning in meanings(model).items():
            for key in {name, linear(name)} & section["properties"].keys():
                section["properties"][key]["description"] = plain(meaning)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def meanings(model: type[BaseModel]) -> dict[str, str]:
    """Return the texts below the declarations of a model's fields."""
    found: dict[str, str] = {}
    for owner in reversed(model.__mro__):
        module = inspect.getmodule(owner)
        if module is not None and owner.__name__ in (texts := _texts(module)):
            found |= texts[owner.__name__]
    return {name: text for name, text in found.items() if name in model.model_fields}


def plain(text: str) -> str:
    """Return a text in Markdown without its links."""
    return _LINK.sub(r"\1", text)


@lru_cache(maxsize=64)
def _texts(module: ModuleType) -> dict[str, dict[str, str]]:
    """Return the texts below the declarations in the classes of a module of this package."""
    if not module.__name__.startswith("fsw.config."):
        return {}
    return {
        statement.name: dict(_described(statement))
        for statement in ast.parse(inspect.getsource(module)).body
        if isinstance(statement, ast.ClassDef)
    }


def _described(section: ast.ClassDef) -> Iterator[tuple[str, str]]:
    for declared, below in zip(section.body, section.body[1:], strict=False):
        match declared, below:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(text))),
            ):
                yield name, " ".join(text.split())


def _models(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """Yield a model and those of its sections."""
    yield model
    for field in model.model_fields.values():
        inner = model_in(field.annotation)
        if inner is not None:
            yield from _models(inner)


def _values(schema: Mapping[str, Any]) -> str:
    """Return the allowed values of one key in words."""
    if "anyOf" in schema:
        inner = next(option for option in schema["anyOf"] if option.get("type") != "null")
        return f"{_values(inner)} or null"
    if "enum" in schema or "const" in schema:
        return ", ".join(map(str, schema.get("enum", [schema.get("const")])))
    if schema["type"] == "array" and "prefixItems" in schema:
        return f"{len(schema['prefixItems'])} numbers {_bounds(schema['prefixItems'][0])}".strip()
    if schema["type"] == "array":
        return f"list of {_values(schema['items'])}"
    names = {"boolean": "true, false", "string": schema.get("format", "text")}
    return str(names.get(schema["type"], f"{schema['type']} {_bounds(schema)}".strip()))


def _bounds(schema: Mapping[str, Any]) -> str:
    signs = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    return ", ".join(f"{sign} {schema[key]:.10g}" for key, sign in signs.items() if key in schema)


def _yaml(value: object) -> str:
    match value:
        case float():
            return f"{value:g}"
        case Path():
            return str(value)
        case tuple():
            return yaml.safe_dump(list(value), default_flow_style=True).strip()
    return yaml.safe_dump(value).splitlines()[0]
