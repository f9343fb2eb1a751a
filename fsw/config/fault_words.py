"""Translate faults that pydantic reports into words for the user of a configuration."""

import re
from collections.abc import Mapping
from typing import Any

from pydantic_core import ErrorDetails

from fsw.errors import brief

WORDS = {  # by pydantic's type of fault, whose context supplies the bounds
    "greater_than": "must be above {gt:.12g}",
    "greater_than_equal": "must be at least {ge:.12g}",
    "less_than": "must be below {lt:.12g}",
    "less_than_equal": "must be at most {le:.12g}",
    "finite_number": "must be a finite number",
    "literal_error": "must be {expected}",
    "string_pattern_mismatch": "must be letters, digits and the signs in {pattern}",
    "lacks_entries": "has {actual_length} entries; must have {whole_length}",
    "too_long": "has {actual_length} entries; must have at most {max_length}",
    "too_short": "has {actual_length} entries; must have at least {min_length}",
    **dict.fromkeys(("float_type", "float_parsing"), "must be a number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "must be a whole number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "must be true or false"),
    **dict.fromkeys(("tuple_type", "list_type"), "must be a list"),
    **dict.fromkeys(("model_type", "dict_type"), "must be a section of keys and values"),
    **dict.fromkeys(("string_type", "path_type"), "must be text"),
}
BOUNDS = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")
UNITS = {"m": "metres", "s": "seconds", "rad": "radians", "kg": "kilograms"}
COMMA = re.compile(r"[-+]?\d+,\d+")
COUNTED = ("too_long", "too_short")  # their words state the number found
YAML = {None: "null", True: "true", False: "false"}


def bound_words(fault: ErrorDetails) -> str:
    """Return the allowed values of a faulty key in words."""
    context: Mapping[str, Any] = fault.get("ctx", {})
    text = fault["msg"].removeprefix("Value error, ")
    try:
        words = WORDS.get(fault["type"], "{text}").format(text=text, **context)
    except (KeyError, ValueError):  # a bound of another type than pydantic's own
        return text
    if fault["type"] in BOUNDS and (unit := _unit(fault)):
        return f"{words} {unit}"
    if fault["type"] == "float_parsing" and COMMA.fullmatch(str(fault["input"])):
        return f"{words} with a decimal point"
    return words


def _unit(fault: ErrorDetails) -> str:
    """Return the unit in the name of the innermost key; empty: none that is often mistaken."""
    names = [part for part in fault["loc"] if isinstance(part, str)]
    return UNITS.get(names[-1].rpartition("_")[2], "") if names else ""


def found_words(value: object) -> str:
    """Return a value as YAML writes it, cut to one line."""
    is_word = value is None or isinstance(value, bool)
    return YAML[value] if is_word else brief(value)  # type: ignore[index]
