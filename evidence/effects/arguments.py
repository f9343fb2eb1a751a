"""The arguments of `hil study effects`; no import of what flies."""

import argparse

from hil.options import add_seeds

COMMAND = "study effects"
HELP = "wheels, thrusters, panel, liquid, contact, arms: from samples"
EXAMPLE = "hil study effects wheels_leo --count 20 --out runs/effects"
FUNCTION = "evidence.effects.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO", help="every servicer's")
    add_seeds(parser, 50, "list")
