"""Kinds of command-line options."""

import argparse
from collections.abc import Callable
from importlib import import_module


def count(text: str) -> int:
    """Return a count; argparse names the option of an invalid one."""
    number = int(text) if text.isdecimal() else 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text}: must be a whole number of at least 1")
    return number


def seed(text: str) -> int:
    """Return a seed; argparse names the option of an invalid one."""
    return count_or_none(text)


def count_or_none(text: str) -> int:
    """Return a count that may be 0; argparse names the option of an invalid one."""
    if not (text.isascii() and text.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text}: must be a whole number of at least 0")
    return int(text)


def call(arguments: argparse.Namespace) -> int:
    """Call the function that a command names, with its options as keywords; return the exit code.

    A command of its own gets the arguments as they are. Modules are imported when they are called,
    so that the help needs none of them.
    """
    given = vars(arguments)
    if "command" in given:
        command: Callable[[argparse.Namespace], int] = given["command"]
        return command(arguments)
    module, name = given.pop("function").split(":")
    return int(getattr(import_module(module), name)(**given))
