"""The arguments of `hil study trivial-energy`; no import of what flies."""

import argparse

COMMAND = "study trivial-energy"
HELP = "why CE as printed has a trivial solution"
EXAMPLE = "hil study trivial-energy"
FUNCTION = "evidence.methods.command:energy"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    del parser
