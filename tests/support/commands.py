"""The commands of the project as their parsers know them."""

import argparse
import shlex
from collections.abc import Iterator
from contextlib import redirect_stderr
from importlib import import_module
from io import StringIO

PROGRAMS = ("fsw", "hil", "ground")


def parser_of(program: str) -> argparse.ArgumentParser:
    """Return the whole parser of a program."""
    parser: argparse.ArgumentParser = import_module(f"{program}.__main__").parser()
    return parser


def leaves(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yield the parsers of the commands that can be run, at any depth."""
    below = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    for action in below:
        for inner in action.choices.values():
            yield from leaves(inner)
    if not below:
        yield parser


def command_line_fault(line: str) -> str:
    """Return why a program's parser refuses a command line; empty: it accepts it."""
    program, *words = shlex.split(line, comments=True)
    said = StringIO()
    try:
        with redirect_stderr(said):
            parser_of(program).parse_args(words)
    except SystemExit as end:
        return said.getvalue() if end.code else ""
    return ""
