"""The arguments of `hil alarms`; no import of what flies."""

import argparse

from hil.options import add_resumable, count_or_none

COMMAND = "alarms"
HELP = "clean flights on fresh seeds: which checks fire?"
EXAMPLE = "hil alarms --scenario target_leo --samples 100 --bytes 10 --out runs/alarms"
FUNCTION = "evidence.alarms.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--scenario", action="append", default=[], help="this one; may be repeated; nine"
    )
    parser.add_argument(
        "--samples", type=count_or_none, default=1000, metavar="N", help="flights of each, 1000"
    )
    parser.add_argument(
        "--bytes",
        type=count_or_none,
        default=100,
        metavar="N",
        dest="from_bytes",
        help="flights of each from the devices' bytes, 100",
    )
    add_resumable(parser, "flights")
