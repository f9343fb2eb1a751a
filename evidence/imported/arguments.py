"""The arguments of `hil imported`; no import of what flies."""

import argparse

from hil.options import add_seeds, add_several

COMMAND = "imported"
HELP = "tables of an arm: motion, poses, a wrist"
EXAMPLE = "hil imported --motion poses --first 100 --count 10"
FUNCTION = "evidence.imported.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_several(parser, "--motion", ("moving", "poses"), "this one")
    add_seeds(parser, 10, "list")
