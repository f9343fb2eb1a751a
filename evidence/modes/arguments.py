"""The arguments of `hil study modes`; no import of what flies."""

import argparse
from pathlib import Path

COMMAND = "study modes"
HELP = "sigma over the bound, of panels and liquid"
EXAMPLE = "hil study modes panel_leo --runs runs/panel"
FUNCTION = "evidence.modes.command:study"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("scenario", metavar="SCENARIO", help="with panels or liquid, declared")
    parser.add_argument(
        "--runs", type=Path, required=True, metavar="DIR", help="of `hil seeds SCENARIO --out DIR`"
    )
