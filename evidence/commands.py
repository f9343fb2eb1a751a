"""Commands of the long evidence: those that the packages beside this module declare.

A package whose module `arguments` has COMMAND (with the word `study` before it, a study), HELP,
EXAMPLE, FUNCTION and `add_arguments` is a command; nothing else names it.
"""

import argparse
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pkgutil import iter_modules
from types import ModuleType

import evidence


def add_parsers(
    commands: "argparse._SubParsersAction[argparse.ArgumentParser]",
    studies: "argparse._SubParsersAction[argparse.ArgumentParser]",
) -> None:
    """Add the commands and the studies; what they run is imported when it is run."""
    for declared in declarations():
        *study, name = declared.COMMAND.split()
        parser = (studies if study else commands).add_parser(
            name, help=declared.HELP, epilog=f"example: {declared.EXAMPLE}"
        )
        declared.add_arguments(parser)
        parser.set_defaults(function=declared.FUNCTION)


def declarations() -> Iterator[ModuleType]:
    """Yield the modules that declare a command, by the names of their packages."""
    for found in sorted(iter_modules(evidence.__path__, f"{evidence.__name__}.")):
        if found.ispkg and find_spec(f"{found.name}.arguments"):
            yield import_module(f"{found.name}.arguments")
