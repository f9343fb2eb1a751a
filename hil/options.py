"""Types of command-line options, and the call of a command's function."""

import argparse
from collections.abc import Callable
from importlib import import_module
from pathlib import Path


def count(text: str) -> int:
    """Return a count of at least 1; argparse reports an invalid count with its option."""
    number = int(text) if text.isdecimal() else 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text}: must be a whole number of at least 1")
    return number


def seed(text: str) -> int:
    """Return a seed of at least 0; argparse reports an invalid seed with its option."""
    return count_or_none(text)


def count_or_none(text: str) -> int:
    """Return a count of at least 0; argparse reports an invalid count with its option."""
    if not (text.isascii() and text.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text}: must be a whole number of at least 0")
    return int(text)


def add_resumable(parser: argparse.ArgumentParser, kept: str) -> None:
    """Add the options of a campaign that can be resumed: `--jobs`, `--out` and `--json`."""
    parser.add_argument("--jobs", type=count, default=1, metavar="N", help="processes, 1")
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"keep the {kept} and resume")
    parser.add_argument("--json", action="store_true", dest="as_json", help="print one JSON object")


def call(arguments: argparse.Namespace) -> int:
    """Call the function that a command names, with its options as keywords; return the exit code.

    A command with the key `command` gets the whole namespace instead. The module of a function is
    imported when the function is called, so that the help imports none.
    """
    given = vars(arguments)
    if "command" in given:
        command: Callable[[argparse.Namespace], int] = given["command"]
        return command(arguments)
    module, name = given.pop("function").split(":")
    return int(getattr(import_module(module), name)(**given))
