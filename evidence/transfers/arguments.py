"""The arguments of `hil transfers`; no import of what flies."""

import argparse
from pathlib import Path

from hil.options import add_drawn, count

COMMAND = "transfers"
HELP = "file transfers, a quarter interrupted"
EXAMPLE = "hil transfers --count 20 --out runs/transfers"
FUNCTION = "evidence.transfers.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--count", type=count, default=200, metavar="N", help="in all, 200")
    add_drawn(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="resumed there")
