"""Configuration text: YAML that refuses a key written twice, and faults in words.

A fault names the key, the value found and the bound or the choices, one line each.
"""

from __future__ import annotations

from collections.abc import Hashable
from difflib import get_close_matches
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails


class _StrictLoader(yaml.SafeLoader):
    """The safe loader, except that a mapping with a repeated key is an error, not a guess."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: dict[Any, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue  # the safe loader says what is wrong with it
            line = key.start_mark.line + 1
            if key.value in seen:
                raise yaml.constructor.ConstructorError(
                    problem=f"key {key.value!r} stands twice, in lines {seen[key.value]} and {line}"
                )
            seen[key.value] = line
        return super().construct_mapping(node, deep)


def read_yaml(source: bytes) -> object:
    """Return the plain values of a YAML text. Raises yaml.YAMLError."""
    data: object = yaml.load(source, _StrictLoader)  # a SafeLoader: builds plain values only
    return data


def explain(model: type[BaseModel], error: ValidationError) -> list[str]:
    """Return one line per fault: key, what is allowed, the value found."""
    faults = error.errors()
    inner = {fault["loc"][:k] for fault in faults for k in range(len(fault["loc"]))}
    # a list that is "too short" only because its items are faulty is no fault of its own
    return [_line(model, f) for f in faults if f["type"] != "too_short" or f["loc"] not in inner]


def _line(model: type[BaseModel], fault: ErrorDetails) -> str:
    key = ".".join(str(part) for part in fault["loc"])
    kind, value = fault["type"], fault["input"]
    if kind == "extra_forbidden":
        allowed = sorted(_section(model, fault["loc"][:-1]))
        close = get_close_matches(str(fault["loc"][-1]), allowed, n=1)
        hint = f"did you mean {close[0]!r}? " if close else ""
        return f"{key}: unknown key (value: {value!r}); {hint}allowed here: {', '.join(allowed)}"
    if kind == "missing":
        return f"{key}: missing; this key is required"
    text = fault["msg"].removeprefix("Value error, ")
    text = text[:1].lower() + text[1:] if text.startswith("Input ") else text
    prefix = f"{key}: " if key else ""
    return prefix + text + ("" if isinstance(value, dict | BaseModel) else f" (value: {value!r})")


def _section(model: type[BaseModel], path: tuple[int | str, ...]) -> list[str]:
    """Return the keys allowed at a path below the model."""
    for part in path:
        if isinstance(part, int) or part not in model.model_fields:
            continue  # an index of a list, or the free key of a mapping
        inner = model_in(model.model_fields[part].annotation)
        if inner is None:
            return []
        model = inner
    return list(model.model_fields)


def model_in(annotation: object) -> type[BaseModel] | None:
    """Return the section a field's type holds, bare, optional, listed or mapped; else None."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if get_origin(annotation) in (Annotated, Union, UnionType, tuple, list, dict):
        for inner in get_args(annotation):
            found = None if inner in (NoneType, Ellipsis) else model_in(inner)
            if found is not None:
                return found
    return None
