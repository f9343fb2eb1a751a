"""The arguments of `hil faults`; no import of what flies."""

import argparse
from pathlib import Path

from hil.options import add_several, count, seed

COMMAND = "faults"
HELP = "every fault in a run of its own, against bounds"
EXAMPLE = "hil faults --only torque_drift --lane virtual"
FUNCTION = "evidence.fault_matrix.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--only", action="append", default=[], metavar="NAME", help="this fault; may be repeated"
    )
    words = (
        "in virtual time, of the machine, on a real bus: all of these; disk: alone, 200 bad disks"
    )
    lanes = ("virtual", "machine", "socketcan", "disk")
    add_several(parser, "--lane", lanes, words, dest="lanes")
    parser.add_argument("--seed", type=seed, default=1, metavar="N", help="fixes every bit, 1")
    parser.add_argument("--jobs", type=count, default=2, metavar="N", help="processes, 2")
    parser.add_argument("--short", action="store_true", help="the selection that the tests run")
    parser.add_argument("--json", action="store_true", dest="as_json", help="print one JSON object")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep outcomes and resume")
