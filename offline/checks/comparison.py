"""A declared value of a configuration compared with the value found in a recording."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from fsw.config import Config
from fsw.errors import ConfigError

WRONG = "WRONG: "


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Declared and found value of one key; `wrong` and `note` are words, empty if it fits.

    `adopted`: the declared value hides other mistakes, which are searched for with the found one.
    """

    key: str
    declared: float
    found: float
    wrong: str = ""
    note: str = ""
    adopted: bool = False

    def text(self) -> str:
        """Return the comparison as a line of text."""
        verdict = f"{WRONG}{self.wrong}" if self.wrong else self.note or "fits"
        return f"{self.key}: declared {self.declared:.3g}, found {self.found:.3g}; {verdict}"


def with_found(config: Config, comparisons: Sequence[Comparison]) -> Config:
    """Return the configuration with the found values that are to be adopted.

    If it would not be valid with them, return it unchanged.
    """
    wrong = [own for own in comparisons if own.adopted]
    if not wrong:
        return config
    data: dict[str, Any] = config.model_dump()
    for own in wrong:
        *path, last = own.key.split(".")
        section = data
        for name in path:
            section = section[int(name)] if name.isdigit() else section[name]  # type: ignore[index]
        section[last] = own.found
    heads = {own.key.partition(".")[0] for own in wrong}
    try:
        return config.with_sections(**{head: data[head] for head in heads})
    except ConfigError:
        return config
