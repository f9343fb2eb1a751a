"""Commands of the long evidence: those that the packages beside this module declare.

A package that has COMMAND, of `evidence.declaration`, is a command; nothing else names it.
"""

import argparse
from collections.abc import Iterator
from importlib import import_module
from pkgutil import iter_modules

import evidence
from evidence.declaration import Command


def add_parsers(
    commands: "argparse._SubParsersAction[argparse.ArgumentParser]",
    studies: "argparse._SubParsersAction[argparse.ArgumentParser]",
) -> None:
    """Add the commands and the studies; what they run is imported when it is run."""
    for declared in declarations():
        *study, name = declared.name.split()
        parser = (studies if study else commands).add_parser(
            name, help=declared.help, epilog=f"example: {declared.example}"
        )
        for add in declared.options:
            add(parser)
        parser.set_defaults(function=declared.function)


def declarations() -> Iterator[Command]:
    """Yield the declared commands, by the names of their packages."""
    for found in sorted(iter_modules(evidence.__path__, f"{evidence.__name__}.")):
        declared = getattr(import_module(found.name), "COMMAND", None) if found.ispkg else None
        if isinstance(declared, Command):
            yield declared
