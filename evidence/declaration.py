"""What a package of evidence declares: its command, and the options that several commands have.

No import of what flies: the command line imports every declaration.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.options import count, seed

Option = Callable[[argparse.ArgumentParser], object]  # adds an option to a parser


@dataclass(frozen=True, slots=True)
class Command:
    """A command of `hil`: `name`, with the word `study` before it if it is a study.

    `function` names what runs it, as module:function; it gets the options as keywords.
    """

    name: str
    help: str
    example: str
    function: str
    options: tuple[Option, ...]


def declared(name: str, words: str, example: str, function: str, *options: Option) -> Command:
    """Return a command; `words` is its help."""
    return Command(name, words, example, function, options)


def option(flag: str, **settings: Any) -> Option:  # noqa: ANN401  as argparse takes them
    """Return the option that `ArgumentParser.add_argument` adds with these settings."""
    return lambda parser: parser.add_argument(flag, **settings)


def several(flag: str, choices: Sequence[str], words: str, dest: str | None = None) -> Option:
    """Return an option that may be repeated; without it the list is empty."""
    words = f"{words}; may be repeated"
    return option(flag, dest=dest, action="append", default=[], choices=choices, help=words)


def resumable(kept: str, printed: str = "object") -> tuple[Option, ...]:
    """Return `--jobs`, `--out` and `--json`; `printed` names the JSON type in the help text."""
    return (
        option("--jobs", type=count, default=1, metavar="N", help="processes, 1"),
        option("--out", type=Path, metavar="DIR", help=f"keep the {kept} and resume"),
        option("--json", action="store_true", dest="as_json", help=f"print one JSON {printed}"),
    )


def seeds(number: int, printed: str) -> tuple[Option, ...]:
    """Return the options of evidence over seeds."""
    return (
        option("--first", type=seed, default=0, metavar="K", help="first seed, 0"),
        option("--count", type=count, default=number, metavar="N", help=f"seeds, {number}"),
        *resumable("rows", printed),
    )


DRAWN = option(
    "--seed",
    type=seed,
    metavar="K",
    help="default: drawn from the commit's hash; for development, below 1000",
)
RESUMED = option("--out", type=Path, required=True, metavar="DIR", help="resumed from there")
