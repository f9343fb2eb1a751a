"""The arguments of `hil rough`; no import of what flies."""

import argparse

from hil.options import add_seeds, add_several

COMMAND = "rough"
HELP = "friction, wrong links, coloured noise: honest?"
EXAMPLE = "hil rough --case target --count 50 --out runs/rough"
FUNCTION = "evidence.rough.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_several(parser, "--case", ("target", "base", "both"), "what is unknown")
    words = (
        "rough world declared or undeclared; ideal one, declared as exact, with the terms of the "
        "rough one, with default uncertainties"
    )
    told = ("declared", "undeclared", "exact", "terms", "defaults")
    add_several(parser, "--told", told, words)
    add_seeds(parser, 50, "list")
