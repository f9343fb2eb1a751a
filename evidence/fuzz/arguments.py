"""The arguments of `hil fuzz`; no import of what flies."""

import argparse
from pathlib import Path

from hil.options import add_drawn

COMMAND = "fuzz"
HELP = "coverage-guided fuzzing of every byte parser"
EXAMPLE = "hil fuzz --inputs 1e6 --only stim300 --out runs/fuzz"
FUNCTION = "evidence.fuzz.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--inputs", type=float, default=1e7, metavar="N", help="in all, 1e7")
    add_drawn(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="resumed from there")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="copy a small corpus there")
    parser.add_argument("--only", default="", metavar="TARGET", help="all inputs for one target")
    parser.add_argument(
        "--live", action="store_true", help="with --only operations: real processes, N cases"
    )
    parser.add_argument(
        "--random", action="store_true", help="with --only operations: N cases, no coverage, fast"
    )
