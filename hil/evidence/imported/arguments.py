"""The arguments of `hil imported`; no import of what flies."""

import argparse

from hil.options import add_seeds

COMMAND = "imported"
HELP = "tables of an arm: motion, poses, a wrist"
EXAMPLE = "hil imported --motion poses --first 100 --count 10"
FUNCTION = "hil.evidence.imported.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--motion",
        action="append",
        default=[],
        choices=("moving", "poses"),
        help="this one; may be repeated",
    )
    add_seeds(parser, 10, "list")
