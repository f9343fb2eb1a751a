"""Commands and flags in texts, as calls of the Python API: arrays have no files to name."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from typing import TypeVar, cast

from fsw.errors import ConfigError, EstimatorError

T = TypeVar("T")

# a command or a flag in a text about a recording -> what a user of arrays has
CALLS = {
    r"fsw check CONFIG RECORDING": "fsw.check(samples, robot)",
    r"fsw import --shift \S+?=([-+.\de]+)": r"t_imu_s + \1",
    r"fsw excite": "fsw.plan",
    r"--reference EMPTY": "reference=",
    r"--from\b": "from_s",
    r"--to\b": "to_s",
    r"--target-mass-kg\b": "prior: target.mass_kg",
    r"--imu\b": "settings: imu",
    r"--(reference|holdout|weighting|method|tool|unknown|base|torque)\b": r"\1",
}


@contextmanager
def errors_in_calls(path: object = "samples") -> Iterator[None]:
    """Raise the errors of the block with their text as `in_calls` returns it."""
    try:
        yield
    except (ConfigError, EstimatorError) as error:
        raise type(error)(in_calls(str(error), path)) from error


def in_calls(value: T, path: object = "samples") -> T:
    """Return text, or values and results with calls for commands; `path`: the samples."""
    found: object = value
    if isinstance(value, dict):
        found = {key: in_calls(own, path) for key, own in value.items()}
    elif isinstance(value, list | tuple) and not hasattr(value, "_fields"):
        found = type(value)(in_calls(own, path) for own in value)
    elif is_dataclass(value) and not isinstance(value, type):
        parts = {own.name: in_calls(getattr(value, own.name), path) for own in fields(value)}
        found = replace(value, **parts)
    elif isinstance(value, str):
        text = value.replace(str(path), "samples")
        for command, call in CALLS.items():
            text = re.sub(command, call, text)
        found = text
    return cast("T", found)
