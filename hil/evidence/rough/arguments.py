"""The arguments of `hil rough`; no import of what flies."""

import argparse

from hil.options import add_seeds

COMMAND = "rough"
HELP = "friction, wrong links, coloured noise: honest?"
EXAMPLE = "hil rough --case target --count 50 --out runs/rough"
FUNCTION = "hil.evidence.rough.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--case",
        action="append",
        default=[],
        choices=("target", "base", "both"),
        help="what is unknown; may be repeated",
    )
    parser.add_argument(
        "--told",
        action="append",
        default=[],
        choices=("declared", "undeclared", "exact", "terms", "defaults"),
        help="rough world declared or undeclared; ideal one, declared as exact, with the terms of"
        " the rough one, with default uncertainties; may be repeated",
    )
    add_seeds(parser, 50, "list")
