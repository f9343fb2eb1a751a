"""Messages about an invalid scenario file: the kind of another file, and the faults by key."""

import json
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

LONGEST_VALUE = 60  # characters of a wrong value that a message repeats
MOST_FAULTS = 4  # in one message
REFERENCE = "hil schema explains every key"
WORDS = {  # by pydantic's type of fault, whose context has the bounds
    "greater_than": "must be above {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be below {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "literal_error": "must be {expected}",
    "too_short": "must have at least {min_length} entries",
    "too_long": "must have at most {max_length} entries",
    "dataclass_type": "must be a section of keys and values",
}
KINDS = {  # by the first word of other types of fault
    "float": "a number",
    "finite": "a finite number",
    "int": "a whole number",
    "bool": "true or false",
    "string": "text",
    "path": "a file's name",
    **dict.fromkeys(("list", "tuple"), "a list"),
    **dict.fromkeys(("dict", "model"), "a section of keys and values"),
}
UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
OTHER_TEXTS = {b"\x89MCAP": "a recording; fsw identify reads it", b"<": "XML, such as a URDF"}
OTHER_KEYS = {  # kind of a mapping that has the key and no `sensors`
    "control_points_rad": "a motion, as fsw excite plans one",
    "buses": "a configuration of the daemon; fsw check reads it",
    "joint_speed_rad_s": "the limits of a motion; fsw excite reads them",
}


def other_text(path: Path) -> str:
    """Return the kind of a file that is not YAML, by its first bytes; "" if unknown."""
    with path.open("rb") as file:
        start = file.read(8).lstrip()
    return next((words for begin, words in OTHER_TEXTS.items() if start.startswith(begin)), "")


def other_kind(document: Mapping[str, Any], scenario: type[BaseModel]) -> str:
    """Return the kind of a mapping that is not a scenario; "" if it may be a scenario."""
    needed = {key for key, field in scenario.model_fields.items() if field.is_required()}
    if "sensors" in document or 2 * len(needed & document.keys()) > len(needed):
        return ""
    kinds = (words for key, words in OTHER_KEYS.items() if key in document)
    return next(kinds, f"something else: {', '.join(sorted(needed - document.keys()))} are missing")


def faults(error: ValidationError, model: type[Any] | None = None) -> str:
    """Return the faults in one line: key, bound, and the value where it is short.

    `model` : the model that rejected the file; None: an unknown key has no hint at a similar key
    """
    errors = sorted(error.errors(), key=lambda e: e["type"] not in UNKNOWN)
    found = []
    for e in errors[:MOST_FAULTS]:
        key = ".".join(str(k) for k in e["loc"]) or "the file"
        if e["type"] in UNKNOWN:
            found.append(f"{key}: unknown key; {_hint(model, e['loc'])}")
            continue
        if e["type"] == "missing":
            where, _, last = key.rpartition(".")
            start = f"{where}: entry {int(last) + 1} is" if last.isdecimal() else f"{key}:"
            found.append(f"{start} missing")
            continue
        words, value = _bound(e), json.dumps(e["input"], default=str)  # as YAML writes it
        is_short = len(value) <= LONGEST_VALUE and "value:" not in words
        found.append(f"{key}{words}" + f" (value: {value})" * is_short)
    more = len(errors) - len(found)
    return "; ".join([*found, f"and {more} more"] if more else found)


def _bound(fault: ErrorDetails) -> str:
    """Return what stands between key and value: the key's end in words of our own, the bound."""
    kind, own = fault["type"], fault["msg"].removeprefix("Value error, ")
    if kind in WORDS:
        return ": " + WORDS[kind].format(**fault.get("ctx", {}))
    if of_kind := KINDS.get(kind.partition("_")[0]):
        return f": must be {of_kind}"
    return ("." if own.startswith("rpy_BS_rad:") else ": ") + own


def _hint(model: type[Any] | None, place: tuple[int | str, ...]) -> str:
    allowed = [] if model is None else _keys(model, place[:-1])
    close = get_close_matches(str(place[-1]), allowed, n=1)
    return f"did you mean {close[0]!r}?" if close else REFERENCE


def _keys(model: type[Any], place: tuple[int | str, ...]) -> list[str]:
    """Return the keys of the section at `place` in a model, from the model's JSON Schema."""
    whole = (
        model.model_json_schema()
        if issubclass(model, BaseModel)
        else TypeAdapter(model).json_schema()
    )
    definitions = whole.get("$defs", {})
    node = whole
    for part in place:
        inner = node.get("items") if isinstance(part, int) else None
        named = node.get("properties", {}).get(part, node.get("additionalProperties"))
        node = _section(inner or named, definitions)
    return list(node.get("properties", ()))


def _section(node: object, definitions: Mapping[str, Any]) -> dict[str, Any]:
    """Return the schema of a section, list or mapping, with references and options resolved."""
    if not isinstance(node, dict):
        return {}
    if "$ref" in node:
        return dict(definitions[node["$ref"].rpartition("/")[2]])
    options = (_section(option, definitions) for option in node.get("anyOf", ()))
    return next((option for option in options if option.get("type") in ("object", "array")), node)
