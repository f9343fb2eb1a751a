"""The arguments of `hil calibration`; no import of what flies."""

import argparse

from hil.options import add_seeds

COMMAND = "calibration"
HELP = "fsw calibrate against wrong sensors"
EXAMPLE = "hil calibration --scenario bench_target --count 20 --out runs/calibration"
FUNCTION = "hil.evidence.calibration.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--scenario",
        action="append",
        default=[],
        choices=("target_leo", "table_target", "bench_target"),
        help="this one; may be repeated",
    )
    add_seeds(parser, 20, "object")
