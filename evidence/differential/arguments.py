"""The arguments of `hil differential`; no import of what flies."""

import argparse

from hil.options import add_seeds

COMMAND = "differential"
HELP = "same motion, empty: half the error?"
EXAMPLE = "hil differential --count 3"
FUNCTION = "evidence.differential.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_seeds(parser, 20, "object")
