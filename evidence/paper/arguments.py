"""The arguments of `hil study paper`; no import of what flies."""

import argparse
from pathlib import Path

from hil.options import count, count_or_none

COMMAND = "study paper"
HELP = "the paper's tables and figure, and the fused estimator"
EXAMPLE = "hil study paper --quick"
FUNCTION = "evidence.paper.command:paper"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--quick", action="store_true", help="one seed, 100 Hz, no device bytes")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep results and resume from them")
    parser.add_argument("--seeds", type=count, metavar="N", help="per cell of Tables 4-7, 20")
    parser.add_argument(
        "--device-seeds", type=count_or_none, metavar="N", help="of the device bytes, 20"
    )
