"""Read text from outside as YAML within bounds, and describe faults in words.

A fault is one line that names key, value found, and bound or choices.
"""

import re
from collections import Counter
from collections.abc import Hashable, Iterator, Sequence
from difflib import get_close_matches
from itertools import groupby
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from fsw.config.fault_words import COUNTED, bound_words, found_words
from fsw.errors import ConfigError, brief, cut

MAX_TEXT_BYTES = 1 << 16
MAX_DEPTH = 16  # of nested values
MAX_NODES = 10_000
MAX_FAULTS = 20  # most faults reported of one text
# errors that PyYAML raises for text that is not YAML, or for values that do not fit their tags
_READING = (yaml.YAMLError, ValueError, ArithmeticError, LookupError, AttributeError, TypeError)


class TextError(ConfigError):
    """A text that cannot be read as YAML, or exceeds a bound."""


class _StrictLoader(yaml.SafeLoader):
    """The safe loader with errors for repeated keys, large texts and, if not allowed, aliases."""

    def __init__(self, source: bytes, *, aliases: bool) -> None:
        super().__init__(source)
        self._aliases, self._depth, self._nodes = aliases, 0, 0
        self._sizes: dict[str | None, int] = {}  # number of values below each anchor

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose one node; raise ComposerError for excess depth, number, or a forbidden alias."""
        event: yaml.NodeEvent = self.peek_event()  # type: ignore[no-untyped-call]
        before, problem = self._nodes, ""
        self._nodes += 1
        if isinstance(event, yaml.AliasEvent) and (
            not self._aliases or event.anchor in self.anchors
        ):
            self._nodes += self._sizes.get(event.anchor, MAX_NODES)  # alias inside its anchor
            problem = "" if self._aliases else "aliases are not allowed"
        if self._nodes > MAX_NODES:
            problem = problem or f"more than {MAX_NODES} values, aliases written out"
        elif self._depth >= MAX_DEPTH:
            problem = f"values nested deeper than {MAX_DEPTH}"
        if problem:
            line = event.start_mark.line + 1 if event.start_mark else 0
            raise yaml.composer.ComposerError(problem=f"{problem}, in line {line}")
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        if event.anchor is not None:
            self._sizes[event.anchor] = self._nodes - before
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: dict[Any, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue  # the safe loader reports the fault
            line = key.start_mark.line + 1
            if key.value in seen:
                raise yaml.constructor.ConstructorError(
                    problem=f"key {brief(key.value)} stands twice, in lines {seen[key.value]} "
                    f"and {line}"
                )
            seen[key.value] = line
        return super().construct_mapping(node, deep)


CONFIGURATION, RECORDING, URDF = "a configuration", "a recording", "XML, such as a URDF"
LIMITS = "limits of a motion, for fsw excite --limits"
KINDS = {  # kinds of files that users confuse, by a key at the left margin
    "control_points_rad": "a motion, as fsw excite writes one",
    "joint_speed_rad_s": LIMITS,
    "sensors": "a world for hil run",
    "robot": CONFIGURATION,  # a world has one too
}


def kind_of(source: bytes) -> str:
    """Return the kind of a file in words, from its content; empty: the kind is not known."""
    if source.startswith(b"\x89MCAP"):
        return RECORDING
    if source.startswith(b"<"):
        return URDF
    if source.startswith(b"{") and b'"estimate"' in source:
        return "a result (JSON)"
    return next((kind for key, kind in KINDS.items() if f"\n{key}:".encode() in b"\n" + source), "")


def must_be(source: bytes, name: str, wanted: str) -> None:
    """Refuse a file `source` that is plainly of another kind than `wanted`.

    Raises
    ------
    ConfigError with one line that names the file, its kind and the wanted kind.
    """
    if (kind := kind_of(source)) not in ("", wanted):
        raise ConfigError(f"{name}: is {kind}; must be {wanted}")


def read_yaml(source: bytes, *, aliases: bool = False) -> object:
    """Return the plain values of a YAML text.

    Parameters
    ----------
    aliases : whether aliases are allowed; each counts with the size of the value it stands for

    Raises
    ------
    TextError when the text is not YAML, has a forbidden alias or repeated key, or is too large.
    """
    if kind_of(source) == RECORDING:
        raise TextError("is a recording, not a configuration; fsw check CONFIG RECORDING")
    if len(source) > MAX_TEXT_BYTES:
        raise TextError(f"{len(source)} bytes; must be at most {MAX_TEXT_BYTES}")
    try:
        loader = _StrictLoader(source, aliases=aliases)  # a SafeLoader: builds plain values only
        data: object = loader.get_single_data()
    except _READING as error:
        raise TextError(_unread(error)) from error
    return data


def _unread(error: Exception) -> str:
    """Return the line, the column and the reason why a text cannot be read."""
    if isinstance(error, yaml.reader.ReaderError) and error.encoding == "utf-8":
        return f"not text in UTF-8, at byte {error.position}; save the file as UTF-8"
    place = words = ""
    if isinstance(error, yaml.MarkedYAMLError):
        mark, words = error.problem_mark, error.problem or ""
        place = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
    return (
        f"not YAML: {place}{cut(' '.join((words or str(error)).split())) or type(error).__name__}"
    )


def no_sections(data: object) -> str:
    """Return the fault of a file whose values `data` are not a mapping of sections."""
    if data is None:
        return "is empty"
    return f"must be a mapping of sections; found {type(data).__name__}"


def explain(model: type[BaseModel], error: ValidationError) -> list[str]:
    """Return one line per fault, which names key, allowed values and value found."""
    faults = error.errors()
    inner = {fault["loc"][:k] for fault in faults for k in range(len(fault["loc"]))}
    # a list can be "too short" only because its items are faulty: this is not a further fault
    kept = [f for f in faults if f["type"] != "too_short" or f["loc"] not in inner]
    kept = list(_whole_lists(kept))
    lines = [cut(_line(model, fault)) + _choices(model, fault) for fault in kept[:MAX_FAULTS]]
    more = len(kept) - len(lines)
    return [*lines, f"and {more} more faults"] if more else lines


def _whole_lists(faults: Sequence[ErrorDetails]) -> Iterator[ErrorDetails]:
    """Yield the faults, those of a list that lacks several entries as one."""
    lacking = Counter(own["loc"][:-1] for own in faults if _is_lacking(own))
    short = {place for place, count in lacking.items() if count > 1}
    for place, own in groupby(faults, lambda fault: fault["loc"][:-1]):
        every = list(own)
        if place not in short:
            yield from every
            continue
        last = every[-1]
        size = int(last["loc"][-1]) + 1
        context = {"actual_length": size - lacking[place], "whole_length": size}
        yield {**last, "loc": place, "type": "lacks_entries", "ctx": context}


def _is_lacking(fault: ErrorDetails) -> bool:
    return fault["type"] == "missing" and isinstance(fault["loc"][-1], int)


def _line(model: type[BaseModel], fault: ErrorDetails) -> str:
    key = ".".join(cut(str(part), 100) for part in fault["loc"])
    kind, value = fault["type"], fault["input"]
    shown = f"(value: {found_words(value)})"
    if kind == "extra_forbidden":
        return f"{key}: unknown key {shown}"
    if _is_lacking(fault):
        whole = key.rpartition(".")[0]
        return f"{whole}: entry {int(fault['loc'][-1]) + 1} is missing {shown}"
    if kind == "missing":
        return f"{key}: missing; this key is required"
    text, is_section = bound_words(fault), isinstance(value, dict | BaseModel)
    begins_with = re.match(r"\w*", text)
    names_key = is_section and begins_with and begins_with[0] in _section(model, fault["loc"])
    prefix = key + ("." if names_key else ": ") if key else ""
    return prefix + text + f" {shown}" * (not is_section and kind not in COUNTED)


def _choices(model: type[BaseModel], fault: ErrorDetails) -> str:
    """Return all keys that are allowed in place of an unknown one, the closest one first."""
    if fault["type"] != "extra_forbidden":
        return ""
    allowed = sorted(_section(model, fault["loc"][:-1]))
    close = get_close_matches(str(fault["loc"][-1])[:100], allowed, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"; {hint}allowed here: {', '.join(allowed)}"


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
    """Return the model within a field's type (optional, list, tuple or mapping); None: no model."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if get_origin(annotation) in (Annotated, Union, UnionType, tuple, list, dict):
        for inner in get_args(annotation):
            found = None if inner in (NoneType, Ellipsis) else model_in(inner)
            if found is not None:
                return found
    return None
