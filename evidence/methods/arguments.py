"""The arguments of `hil study methods`; no import of what flies."""

import argparse
from pathlib import Path

from hil.options import count, count_or_none

COMMAND = "study methods"
HELP = "every identification method against the Cramer-Rao bound"
EXAMPLE = "hil study methods --quick --out runs/methods"
FUNCTION = "evidence.methods.command:methods"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--quick", action="store_true", help="few seeds of one case")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep results and resume from them")
    parser.add_argument("--seeds", type=count, metavar="N", help="of the sample level, 200")
    parser.add_argument(
        "--device-seeds", type=count_or_none, metavar="N", help="of the device bytes, 30"
    )
    parser.add_argument("--jobs", type=count, default=2, metavar="N", help="processes, 2")
    parser.add_argument(
        "--redo", action="append", default=[], metavar="METHOD", help="drop its stored results"
    )
    parser.add_argument(
        "--report",
        action="store_true",
        dest="report_only",
        help="run nothing, judge what is stored",
    )
