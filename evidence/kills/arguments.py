"""The arguments of `hil kills`; no import of what flies."""

import argparse
from pathlib import Path

from hil.options import add_drawn, count

COMMAND = "kills"
HELP = "kill -9 of loop and service in a real-time run"
EXAMPLE = "hil kills --count 20 --out runs/kills"
FUNCTION = "evidence.kills.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--count", type=count, default=200, metavar="N", help="in all, 200")
    add_drawn(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="resumed from there")
