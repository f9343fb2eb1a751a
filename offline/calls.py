"""Commands and flags in texts, as calls of the Python API: arrays have no files to name."""

import re
from typing import TypeVar, cast

T = TypeVar("T")

# a command or a flag in a text about a recording -> what a user of arrays has
CALLS = {
    r"fsw check CONFIG RECORDING": "fsw.check(samples, robot)",
    r"fsw import --shift \S+?=([-+.\de]+)": r"t_imu_s + \1",
    r"fsw excite": "fsw.plan",
    r"--reference EMPTY": "reference=",
    r"--from\b": "from_s",
    r"--to\b": "to_s",
    r"--(reference|holdout|weighting|method)\b": r"\1",
}


def in_calls(value: T, path: object = "samples") -> T:
    """Return text, or plain values with texts, with calls for commands; `path` is the samples'."""
    found: object = value
    if isinstance(value, dict):
        found = {key: in_calls(own, path) for key, own in value.items()}
    elif isinstance(value, list):
        found = [in_calls(own, path) for own in value]
    elif isinstance(value, str):
        text = value.replace(str(path), "samples")
        for command, call in CALLS.items():
            text = re.sub(command, call, text)
        found = text
    return cast("T", found)
