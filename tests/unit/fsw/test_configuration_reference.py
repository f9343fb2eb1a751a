"""docs/configuration.md against the schema: keys, values, defaults, a working example."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic_core import PydanticUndefined

from fsw.checks.configuration import validate
from fsw.config import Config, load
from fsw.config.text import model_in

DOCUMENT = Path(__file__).parents[3] / "docs" / "configuration.md"
ROW = re.compile(r"^\| `(?P<key>[^`]+)` \| (?P<values>.*?) \| (?P<default>.*?) \| (?P<text>.+) \|$")


def bounds(schema: dict[str, Any]) -> str:
    low = f"> {schema['exclusiveMinimum']:g}" if "exclusiveMinimum" in schema else ""
    low = f">= {schema['minimum']:g}" if "minimum" in schema else low
    high = f"< {schema['exclusiveMaximum']:g}" if "exclusiveMaximum" in schema else ""
    high = f"<= {schema['maximum']:g}" if "maximum" in schema else high
    return ", ".join(part for part in (low, high) if part)


def values_of(schema: dict[str, Any]) -> str:
    """Return the allowed values of one key in words."""
    if "anyOf" in schema:
        inner = next(option for option in schema["anyOf"] if option.get("type") != "null")
        return values_of(inner) + " or null"
    if "enum" in schema or "const" in schema:
        return ", ".join(map(str, schema.get("enum", [schema.get("const")])))
    if schema["type"] == "array" and "prefixItems" in schema:
        return f"{len(schema['prefixItems'])} numbers {bounds(schema['prefixItems'][0])}".strip()
    if schema["type"] == "array":
        return f"list of {values_of(schema['items'])}"
    names = {"boolean": "true, false", "string": schema.get("format", "text")}
    return names.get(schema["type"], f"{schema['type']} {bounds(schema)}".strip())


def reference(model: Any = Config, prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield key, allowed values and default of every key that holds a value."""
    properties = model.model_json_schema()["properties"]
    for name, field in model.model_fields.items():
        inner = model_in(field.annotation)
        kind = str(field.annotation)
        if inner is not None:
            suffix = "[]" if kind.startswith("tuple") else ""
            suffix = ".BODY" if kind.startswith("dict") else suffix
            yield from reference(inner, f"{prefix}{name}{suffix}.")
            continue
        default = "required" if field.default is PydanticUndefined else yaml_words(field.default)
        yield f"{prefix}{name}", values_of(properties[name]), default


def yaml_words(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, tuple):
        return yaml.safe_dump(list(value), default_flow_style=True).strip()
    return yaml.safe_dump(value).splitlines()[0]


def documented() -> dict[str, tuple[str, str]]:
    rows = (ROW.match(line) for line in DOCUMENT.read_text().splitlines())
    return {row["key"]: (row["values"], row["default"]) for row in rows if row is not None}


def test_every_key_of_the_schema_stands_in_the_reference():
    assert {key for key, _, _ in reference()} == set(documented())


@pytest.mark.parametrize(("key", "values", "default"), list(reference()))
def test_values_and_default_are_as_the_schema_has_them(key, values, default):
    assert documented()[key] == (values, default)


def test_the_worked_example_is_a_correct_configuration(arm):
    example = re.search(r"```yaml\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)
    assert example is not None
    arm.robot(6)
    arm.write()
    path = arm.folder / "example.yaml"
    path.write_text(example[1])
    problem, warnings = validate(load(path))
    assert problem.model.n == 6
    assert warnings == []
